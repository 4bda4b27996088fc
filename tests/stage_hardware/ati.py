"""What the tests of ATI's sensors share: a made-up calibration, a box and its driver."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stage_hardware.drivers.ati_net_ft import AtiNetFt
from stage_hardware.emulators.net_ft_box import NetFtBox
from stage_hardware.force_sensor import WRENCH, wrench_components

COMPONENTS = wrench_components((18e3,) * 3, (250.0,) * 3, resolution_mN=4, resolution_mNm=0.05)
LOAD = (1000.0, -2000.0, 3000.0, 10.0, -20.0, 30.0)

CALIBRATION = """<?xml version="1.0" encoding="utf-8"?>
<FTSensor Serial="FT00000" BodyStyle="Nano43" Family="DAQ" NumGages="{gauges}" CalFileVersion="1.0">
  <Calibration PartNumber="SI-18-0.25" CalDate="1/1/2020" ForceUnits="{force}" TorqueUnits="{torque}"
    DistUnits="{length}" OutputMode="Ground Referenced Differential" OutputRange="20" HWTempComp="{compensated}"
    GainMultiplier="1" CableLossDetection="False" OutputBipolar="True">
{axes}
    <BasicTransform Dx="{t[0]}" Dy="{t[1]}" Dz="{t[2]}" Rx="{t[3]}" Ry="{t[4]}" Rz="{t[5]}"/>
  </Calibration>
</FTSensor>
"""


def write_calibration(
    path: Path,
    rows: NDArray[np.float64],
    scales: NDArray[np.float64],
    *,
    transform: tuple[float, ...] = (0.0,) * 6,
    force: str = "N",
    torque: str = "N-mm",
    length: str = "mm",
    compensated: str = "True",
    gauges: int = 6,
) -> Path:
    axes = "\n".join(
        f'    <Axis Name="{name}" values="{" ".join(map(repr, row))}" max="{largest}" scale="{scale!r}"/>'
        for name, row, scale, largest in zip(
            WRENCH, rows.tolist(), scales.tolist(), (18,) * 3 + (250,) * 3, strict=True
        )
    )
    path.write_text(
        CALIBRATION.format(
            axes=axes,
            t=transform,
            force=force,
            torque=torque,
            length=length,
            compensated=compensated,
            gauges=gauges,
        )
    )
    return path


def made_up(generator: np.random.Generator) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Rows (6, 6) and scales (6) such as a sensor of the size of a Nano43 may have."""
    rows = generator.normal(scale=0.3, size=(6, 6)) + 2 * np.eye(6)
    scales = np.r_[generator.uniform(0.3, 3, 3), generator.uniform(0.03, 0.3, 3)]
    return np.round(rows, 7), np.round(scales, 7)


@contextmanager
def reading(box: NetFtBox, **more: Any) -> Iterator[AtiNetFt]:
    with AtiNetFt(
        "wrist",
        box.host,
        **{
            "components": COMPONENTS,
            "rdt_port": box.rdt_port,
            "http_port": box.http_port,
            "rate_Hz": box.rate_Hz,
            "silence_s": 0.3,  # the machine may be slow
            **more,
        },
    ) as sensor:
        yield sensor


def wait_until(condition: Callable[[], bool], within_s: float = 5.0) -> None:
    deadline = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < deadline, "it did not come about in time"
        time.sleep(0.002)
