"""The insertion body on a rig of controllers: what it refuses, and insertions on virtual rigs over the wire."""

import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from precision_interaction.rig.hardware_rig import HardwareRig
from precision_interaction.rig.hardware_rig_config import HardwareRigConfig
from stage_hardware.rig.emulated_rig import EmulatedRig
from stage_hardware.rig.rig_config import load_rig

from neurorobo.config.experiment import load_experiment
from neurorobo.errors import ConfigError, NeuroroboError
from neurorobo.experiment.build import build_task
from neurorobo.safety.machine import SafetyError

EXAMPLES = Path(__file__).parents[2] / "examples"
RIG = EXAMPLES / "rigs" / "pi_venus.yaml"
SECOND = 1_000_000_000
SAFETY = {"force": {"stop": "1 N", "latch": "3 N", "rate": "100 N/s", "age": "500 ms"}}


def config(rig: Path, **changed: object) -> HardwareRigConfig:
    body = {
        "type": "precision.hardware_rig",
        "rig": str(rig),
        "length": "200 um",
        "gap": "80 um",
        "free_force": "0.2 N",
        "safety": SAFETY,
    }
    return HardwareRigConfig.model_validate({**body, **changed})


def small(folder: Path) -> Path:
    """Return the rig with a shorter way to where its axes begin, as they take a second for each mm."""
    rig = folder / "rig.yaml"
    text = RIG.read_text().replace("travel: 0..40 mm", "travel: 0..2 mm").replace("start: 5 mm", "start: 0.5 mm")
    rig.write_text(text.replace("origin: -2.5 mm", "origin: -1.1 mm").replace("travel: -2..2 mm", "travel: -1..1 mm"))
    return rig


def content(name: str) -> dict[str, Any]:
    loaded: dict[str, Any] = yaml.safe_load((EXAMPLES / name).read_text())
    return loaded


def test_moving_to_hardware_is_the_body_alone() -> None:
    real, simulated = content("peg_in_hole_hardware.yaml"), content("peg_in_hole.yaml")
    for key in ("name", "body", "train"):
        real.pop(key, None)
        simulated.pop(key, None)
    assert real == simulated


@pytest.mark.parametrize("missing", ["stop", "latch", "rate", "age"])
def test_limits_that_are_not_set_are_refused(missing: str) -> None:
    limits = {key: value for key, value in SAFETY["force"].items() if key != missing}
    with pytest.raises(ValueError, match=rf"safety: real stages need limits of the force: `{missing}`"):
        config(RIG, safety={"force": limits})


@pytest.mark.parametrize(
    ("changed", "fault"),
    [
        ({"axial": "w"}, "the rig has no axis `w`; it has z, x, y"),
        ({"force": ["Fa", "Fy"]}, "the sensor has no component `Fa`"),
        ({"length": "60 mm"}, "axis `z` can go -5000..35000 um and would go 0..60000 um"),
        ({"max_speed": "5 mm/s"}, "axis `z` moves at 1000 um/s; lower `max_speed`"),
        ({"force": ["Tx", "Fy"]}, "the sensor's component `Tx` is in mN*m, and is no force"),
        (
            {"safety": {"force": {**SAFETY["force"], "latch": "20 N"}}},
            "`safety.force.latch` of 20000 mN would never be seen, as the sensor tells 18000 mN at most; lower it",
        ),
    ],
)
def test_a_rig_that_cannot_do_it_is_refused_before_anything_is_connected(
    changed: dict[str, object], fault: str
) -> None:
    with pytest.raises(NeuroroboError) as refused:
        HardwareRig(config(RIG, **changed))
    assert fault in str(refused.value)


def test_a_fault_of_the_rig_file_has_its_place_there(tmp_path: Path) -> None:
    rig = tmp_path / "rig.yaml"
    rig.write_text("neurorobo_rig: 1\nname: bench\ncontroler: {}\n")
    with pytest.raises(NeuroroboError, match=r"rig\.yaml:3:1: .*`controler`; did you mean `controllers`"):
        build_task(load_experiment(EXAMPLES / "peg_in_hole_hardware.yaml", [f"body.rig={rig}"]))


@pytest.mark.parametrize(
    ("override", "place", "fault"),
    [
        ("rig=nowhere.yaml", "rig", "nowhere.yaml: there is no such file; that of a virtual rig is there while"),
        ("safety.force.stopp=1 N", "safety.force.stopp", "unknown key `stopp`; did you mean `stop`?"),
        ("safety.force.latch=3", "safety.force.latch", "3 needs a unit, that of the sensor or one like it, e.g. '3 N'"),
    ],
)
def test_a_fault_of_the_body_is_told_where_it_is(override: str, place: str, fault: str) -> None:
    with pytest.raises(ConfigError) as refused:
        build_task(load_experiment(EXAMPLES / "peg_in_hole_hardware.yaml", [f"body.{override}"]))
    assert str(refused.value).startswith(f"--set body.{override}: body.{place}: {fault}")


def test_nothing_moves_without_leave() -> None:
    body = HardwareRig(config(RIG))
    with pytest.raises(SafetyError, match="say `--arm` to let it"):
        body.reset([0])
    body.close()


def test_there_is_one_rig() -> None:
    body = HardwareRig(config(RIG))
    with pytest.raises(NeuroroboError, match="one after the other"):
        body.reset([0, 1])


def test_a_latch_outlives_the_process_that_set_it(tmp_path: Path) -> None:
    rig = tmp_path / "rig.yaml"
    rig.write_text(RIG.read_text())
    (tmp_path / "pi_venus.latch.json").write_text('{"place": "force", "fault": "4 N", "since": "yesterday"}')
    with pytest.raises(SafetyError, match="it is latched: force: 4 N, yesterday"):
        HardwareRig(config(rig)).arm()


def test_an_insertion_over_the_wire_goes_where_it_is_sent_and_comes_back(tmp_path: Path) -> None:
    before = set(threading.enumerate())
    with EmulatedRig(load_rig(small(tmp_path))) as emulated:
        rig = tmp_path / "emulated.yaml"
        rig.write_text(emulated.config.dump())
        body = HardwareRig(config(rig, stage_resolution="0.1 um"))
        body.arm()
        try:
            body.reset([0])
            assert emulated.positions() == pytest.approx({"x": 0.0, "y": 0.0, "z": 0.0}, abs=0.11)
            for tick in range(2):
                move = np.array([[1.0, -0.5]])
                body.advance({"axial_speed": np.full((1, 1), 100.0), "radial_move": move}, SECOND)
                there = {"z": 100.0 * (tick + 1), "x": tick + 1.0, "y": -0.5 * (tick + 1)}
                assert emulated.positions() == pytest.approx(there, abs=0.11)
                assert body.read()["travel"][0, 0] == pytest.approx(there["z"], abs=0.11)
                felt = [body.force_mN[0, 0], body.force_mN[0, 1]]
                wrench = emulated.sensor.emulator.wrench(0.0)[:2]
                np.testing.assert_allclose(felt, wrench, atol=4.0)  # the sensor's resolution
            assert body.between_moves.all()
            body.stop()
            assert body.timing()["overruns"] == 0
        finally:
            body.close()
        assert emulated.positions() == pytest.approx({"x": 0.0, "y": 0.0, "z": 0.0}, abs=0.11)
    assert set(threading.enumerate()) <= before


def test_a_dry_run_touches_no_device_and_shows_what_would_be_sent(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    body = HardwareRig(config(small(tmp_path)))
    body.arm(dry_run=True)
    try:
        body.reset([0])
        body.advance({"axial_speed": np.full((1, 1), 50.0)}, SECOND)
        body.stop()
    finally:
        body.close()
    shown = capfd.readouterr().err
    assert "axial" in shown and "MOV 1 0.55" in shown  # mm: 50 um beyond the start
    assert "radial" in shown


def test_what_is_felt_across_and_along_is_not_the_same() -> None:
    with pytest.raises(ValueError, match="`axial_force` and `force` name three components"):
        config(RIG, force=["Fx", "Fz"])
