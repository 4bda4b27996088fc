"""Calibration files of ATI's DAQ F/T sensors (`FT*.cal`): from gauge voltages to a wrench.

With the rows C of the file, each divided by its scale, and the transform of the calibrated origin,

    wrench = T C V,    T = [[R, 0], [R D, R]],    D = [[0, Dz, -Dy], [-Dz, 0, Dx], [Dy, -Dx, 0]],

and R the rotations about x, then y, then z, of the axes. The order is that of ATI's own library.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stage_hardware import force_units
from stage_hardware.errors import HardwareError
from stage_hardware.force_sensor import WRENCH, Component, wrench_components

GAUGES = 6


@dataclass(frozen=True)
class AtiCalibration:
    """One calibration: six components for six gauges.

    ``matrix`` (6, 6) turns gauge voltages (V) into forces (mN) and torques (mN*m), ``largest`` (6) are the calibrated
    ranges of these, and ``full_scale_V`` is the largest voltage, of either sign, that a gauge can give.
    """

    serial: str
    part_number: str
    matrix: NDArray[np.float64]
    largest: tuple[float, ...]
    full_scale_V: float

    def wrench(self, voltages_V: ArrayLike) -> NDArray[np.float64]:
        """Return forces (mN) and torques (mN*m) of gauge voltages (6), counted from the gauges' own zero."""
        return np.asarray(self.matrix @ np.asarray(voltages_V, dtype=np.float64), dtype=np.float64)

    def components(self, *, resolution_mN: float, resolution_mNm: float) -> dict[str, Component]:
        """Return the components of the sensor; its resolutions are on its data sheet, not in the file."""
        fx, fy, fz, tx, ty, tz = self.largest
        return wrench_components((fx, fy, fz), (tx, ty, tz), resolution_mN=resolution_mN, resolution_mNm=resolution_mNm)


def read_calibration(path: str | Path, part_number: str | None = None) -> AtiCalibration:
    """Return the calibration of a file, by its part number such as `SI-18-0.25` if there are several.

    Raises a HardwareError that names the file if it cannot be read or has no such calibration. Files whose gauges are
    to be compensated for temperature by software are refused.
    """
    cure = "take the .cal file that came with the sensor, unchanged"
    try:
        sensor = ElementTree.parse(path).getroot()
    except OSError as error:
        raise HardwareError(str(path), f"cannot be read ({error.strerror})", cure) from None
    except ElementTree.ParseError as error:
        raise HardwareError(str(path), f"is no XML ({error})", cure) from None
    found = {element.get("PartNumber", ""): element for element in sensor.iter("Calibration")}
    if part_number is None and len(found) == 1:
        part_number = next(iter(found))
    if not found:
        raise HardwareError(str(path), "has no calibration", cure)
    if part_number not in found:
        raise HardwareError(
            str(path), f"has the calibrations {', '.join(found)}, not {part_number}", "name one of them"
        )
    try:
        return _calibration(sensor, found[part_number])
    except KeyError as error:
        raise HardwareError(str(path), f"lacks {error.args[0]}", cure) from None
    except ValueError as error:
        raise HardwareError(str(path), f"makes no sense: {error}", cure) from None


def _calibration(sensor: ElementTree.Element, calibration: ElementTree.Element) -> AtiCalibration:
    if sensor.get("NumGages", str(GAUGES)) != str(GAUGES):
        raise ValueError(f"a sensor of a whole wrench has {GAUGES} gauges, not {sensor.get('NumGages')}")
    if calibration.get("HWTempComp", "True").lower() == "false":
        raise ValueError("its gauges are to be compensated for temperature by software, which is not done here")
    force = force_units.force_mN(calibration.attrib["ForceUnits"])
    torque = force_units.torque_mNm(calibration.attrib["TorqueUnits"])
    length = force_units.length_m(calibration.attrib["DistUnits"])
    span = _numbers(calibration.attrib["OutputRange"], 1)[0]
    axes = {axis.get("Name", ""): axis.attrib for axis in calibration.iter("Axis")}
    units = (force,) * 3 + (torque,) * 3
    rows, largest = [], []
    for name, unit in zip(WRENCH, units, strict=True):
        axis = axes[name]
        scale = _numbers(axis["scale"], 1)[0]
        if scale == 0:
            raise ValueError(f"the scale of {name} is 0")
        rows.append([unit * value / scale for value in _numbers(axis["values"], GAUGES)])
        largest.append(unit * _numbers(axis["max"], 1)[0])
    transform = calibration.find("BasicTransform")
    given = {} if transform is None else transform.attrib
    shift_m = [length * _numbers(given.get(name, "0"), 1)[0] for name in ("Dx", "Dy", "Dz")]
    angles_deg = [_numbers(given.get(name, "0"), 1)[0] for name in ("Rx", "Ry", "Rz")]
    return AtiCalibration(
        sensor.get("Serial", ""),
        calibration.get("PartNumber", ""),
        _transform(shift_m, angles_deg) @ np.array(rows),
        tuple(largest),
        span / 2 if calibration.get("OutputBipolar", "True").lower() == "true" else span,
    )


def _numbers(text: str, count: int) -> list[float]:
    found = [float(number) for number in text.split()]
    if len(found) != count or not all(map(math.isfinite, found)):
        raise ValueError(f"{text!r} is not {count} numbers" if count > 1 else f"{text!r} is no number")
    return found


def _transform(shift_m: Sequence[float], angles_deg: Sequence[float]) -> NDArray[np.float64]:
    """Return the matrix (6, 6) of a wrench about another origin, with other axes; mN and mN*m go with m."""
    dx, dy, dz = shift_m
    (cx, cy, cz), (sx, sy, sz) = np.cos(np.radians(angles_deg)), np.sin(np.radians(angles_deg))
    about_x = np.array([[1, 0, 0], [0, cx, sx], [0, -sx, cx]])
    about_y = np.array([[cy, 0, -sy], [0, 1, 0], [sy, 0, cy]])
    about_z = np.array([[cz, sz, 0], [-sz, cz, 0], [0, 0, 1]])
    rotation = about_z @ about_y @ about_x
    lever = np.array([[0, dz, -dy], [-dz, 0, dx], [dy, -dx, 0]])
    return np.block([[rotation, np.zeros((3, 3))], [rotation @ lever, rotation]])
