"""Whole rigs of emulators: every device is driven by its driver, and the force follows from where axes are."""

import sys
import threading
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, ClassVar, Literal

import pytest
from stage_hardware.errors import HardwareError, LinkError, ReplyTimeoutError
from stage_hardware.rig.emulated_rig import EmulatedRig
from stage_hardware.rig.physics import PhysicsConfig, Wrench
from stage_hardware.rig.rig import Rig
from stage_hardware.rig.rig_config import load_rig

from neurorobo.errors import NeuroroboError
from neurorobo.plugins import Registrar, hookimpl
from tests.stage_hardware.rigs import AXIS, EXAMPLES, SENSOR, STAGES, WALL, loaded, registry, rig, until, written

MOCK_SENSOR = {**SENSOR, "type": "stages.mock_force_sensor"}


class PressureConfig(PhysicsConfig):
    """A force that is the position of an axis, or nothing but trouble."""

    implementation: ClassVar[str] = f"{__name__}:Pressure"
    type: Literal["acme.pressure"]
    fails_at: float


class Pressure:
    def __init__(self, config: PressureConfig) -> None:
        if config.fails_at < 0:
            raise ValueError("it fails at once")
        self.config = config

    def wrench(self, positions: Mapping[str, float]) -> Wrench:
        here = positions[self.config.axes[0]]
        if here >= self.config.fails_at:
            raise ZeroDivisionError("too deep")
        return here, 0.0, 0.0, 0.0, 0.0, 0.0


class Acme:
    @hookimpl
    def neurorobo_register(self, registry: Registrar) -> None:
        registry.add("physics", "acme.pressure", f"{__name__}:PressureConfig")


@pytest.fixture(autouse=True)
def no_threads_left() -> Iterator[None]:
    before = set(threading.enumerate())
    yield
    until(lambda: set(threading.enumerate()) <= before)


def homed(rig: Rig) -> Rig:
    rig.home(rig.axes)
    states = rig.wait_until_at_rest(20)
    assert all(state.referenced for state in states.values())
    return rig


@pytest.mark.parametrize("stage", STAGES)
def test_every_stage_homes_and_moves_on_its_emulator_as_fast_as_the_rig_file_says(tmp_path: Path, stage: str) -> None:
    config = loaded(tmp_path, rig(stage, force_sensor=MOCK_SENSOR))
    with EmulatedRig(config) as emulated, emulated.config.build() as built:
        controller = emulated.controllers["controller_0"]
        assert all(position != 0 for position in controller.positions().values())
        assert not any(state.referenced for state in built.state().values())
        homed(built)
        lower, upper = ({name: built.limits(name)[end] for name in built.axes} for end in (0, 1))
        fastest_um_s = 0.0
        for targets in (lower, upper, dict.fromkeys(built.axes, 150.0)):
            built.move_to(targets)
            while any(state.moving for state in built.state().values()):
                speeds = [abs(axis.mechanism.velocity) * axis.um_per_count for axis in controller.axes.values()]
                fastest_um_s = max(fastest_um_s, *speeds)
            assert {name: state.position for name, state in built.state().items()} == pytest.approx(targets)
            assert emulated.positions() == pytest.approx(targets)
        assert 3_000 < fastest_um_s <= 10_000 * (1 + 1e-9)


@pytest.mark.parametrize("sensor", ["ati_net_ft", "mock_force_sensor"])
def test_the_force_follows_from_where_the_axis_is(tmp_path: Path, sensor: str) -> None:
    content = rig("mock_stage", force_sensor={**SENSOR, "type": f"stages.{sensor}"}, emulate=WALL)
    with EmulatedRig(loaded(tmp_path, content)) as emulated, emulated.config.build() as built:
        homed(built)
        for at_um, force_mN in ((0.0, 0.0), (1000.0, 0.0), (1100.0, -200.0), (1302.0, -604.0), (900.0, 0.0)):
            built.move_to({"x": at_um})
            built.wait_until_at_rest(5)
            until(lambda expected=force_mN: abs(built.sensor.latest().values["Fy"] - expected) < 1e-6)  # type: ignore[misc]
            others = {name: value for name, value in built.sensor.latest().values.items() if name != "Fy"}
            assert others == dict.fromkeys(others, 0.0)


def test_the_force_is_felt_while_the_axis_moves_and_not_only_where_it_was_sent(tmp_path: Path) -> None:
    with EmulatedRig(loaded(tmp_path, rig("mock_stage", emulate=WALL))) as emulated, emulated.config.build() as built:
        homed(built)
        felt: list[float] = []
        built.sensor.watch(lambda reading: felt.append(reading.values["Fy"]))
        built.move_to({"x": 1500.0})
        built.wait_until_at_rest(5)
        until(lambda: felt[-1] == -1000.0)
        assert felt == sorted(felt, reverse=True)
        assert len(set(felt)) > 10


def test_an_inverted_axis_runs_into_the_wall_the_other_way(tmp_path: Path) -> None:
    content = rig("mock_stage", emulate={"physics": {**WALL["physics"], "axes": ["y"]}})
    with EmulatedRig(loaded(tmp_path, content)) as emulated, emulated.config.build() as built:
        homed(built)
        built.move_to({"y": 1200.0})
        built.wait_until_at_rest(5)
        assert emulated.controllers["controller_0"].positions()["y"] == pytest.approx(500 - 1200)
        until(lambda: built.sensor.latest().values["Fy"] == -400.0)


def test_the_wall_is_where_it_is_even_if_the_controller_does_not_know_where_its_axis_is(tmp_path: Path) -> None:
    content = rig("shot", emulate={"physics": {**WALL["physics"], "at": "-1 mm"}})
    with EmulatedRig(loaded(tmp_path, content)) as emulated, emulated.config.build() as built:
        switched_on_at = emulated.positions()["x"]
        assert built.state()["x"].position != pytest.approx(switched_on_at)
        until(lambda: built.sensor.latest().values["Fy"] == pytest.approx(-2 * (switched_on_at + 1000), abs=4))


def test_without_physics_the_sensor_feels_nothing(tmp_path: Path) -> None:
    with EmulatedRig(loaded(tmp_path, rig("mock_stage"))) as emulated, emulated.config.build() as built:
        assert set(built.sensor.latest().values.values()) == {0.0}


def test_faults_are_switched_on_by_the_names_of_the_devices(tmp_path: Path) -> None:
    with EmulatedRig(loaded(tmp_path, rig("shot", emulate=WALL))) as emulated, emulated.config.build() as built:
        emulated.controllers["controller_0"].emulator.faults.no_reply = 1
        with pytest.raises(ReplyTimeoutError, match="controller_0: "):
            built.state()
        built.state()
        emulated.box.faults.silent = True
        until(lambda: not built.sensor.latest().valid)
        emulated.box.faults.silent = False
        until(lambda: built.sensor.latest().valid)
        emulated.controllers["controller_0"].emulator.faults.hang_up = True
        with pytest.raises(LinkError):
            for _ in range(100):
                built.state()


def test_a_power_cycle_of_one_controller_is_told_as_its_fault(tmp_path: Path) -> None:
    content = rig(controllers={"slow": STAGES["ds102"], "table": {**STAGES["mock_stage"], "axes": {"w": AXIS}}})
    with EmulatedRig(loaded(tmp_path, content)) as emulated, emulated.config.build() as built:
        homed(built)
        emulated.controllers["slow"].emulator.power_cycle()
        with pytest.raises(HardwareError, match="slow: settings are gone, as after a power cycle"):
            built.state()


def test_physics_that_fails_is_told_and_does_not_end_the_sensor(tmp_path: Path) -> None:
    plugins = registry()
    plugins.add_plugin("acme", Acme())
    physics: dict[str, Any] = {"type": "acme.pressure", "axes": ["x"], "fails_at": 100.0}
    path = written(tmp_path, rig("mock_stage", emulate={"physics": physics}))
    with EmulatedRig(load_rig(path, plugins)) as emulated, emulated.config.build() as built:
        homed(built)
        assert emulated.fault is None
        built.move_to({"x": 200.0})
        built.wait_until_at_rest(5)
        until(lambda: emulated.fault is not None)
        assert emulated.fault == "its physics has failed: ZeroDivisionError: too deep"
        assert built.sensor.latest().valid
    path = written(tmp_path, rig("mock_stage", emulate={"physics": {**physics, "fails_at": -1.0}}))
    with pytest.raises(NeuroroboError, match=r"emulate.physics: acme.pressure cannot be built: it fails at once"):
        EmulatedRig(load_rig(path, plugins))


def test_an_emulator_that_cannot_start_leaves_no_other_running(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    emulated = EmulatedRig(loaded(tmp_path, rig("shot", emulate=WALL)))

    def fails() -> None:
        raise OSError("no port is free")

    monkeypatch.setattr(emulated.box, "start", fails)
    with pytest.raises(OSError, match="no port is free"), emulated:
        pass  # the fixture sees that no thread is left


@pytest.mark.parametrize("example", ["shot_ds102", "pi_venus"])
def test_the_examples_are_homed_and_feel_the_hole(example: str, tmp_path: Path) -> None:
    """With axes ten times as fast, to spare time."""
    text = (EXAMPLES / f"{example}.yaml").read_text()
    faster = text.replace("speed: 0.5 mm/s", "speed: 5 mm/s").replace("speed: 1 mm/s", "speed: 10 mm/s")
    faster = faster.replace("10 mm/s^2", "100 mm/s^2")
    assert faster != text
    with EmulatedRig(loaded(tmp_path, faster)) as emulated, emulated.config.build() as built:
        homed(built)
        start = dict.fromkeys("xyz", 0.0)
        built.move_to(start)
        assert {name: state.position for name, state in built.wait_until_at_rest(10).items()} == start
        built.sensor.bias()
        for depth_um, is_contact in ((30.0, False), (1150.0, True), (0.0, False)):
            built.move_to({"z": depth_um})
            built.wait_until_at_rest(10)
            until(lambda touches=is_contact: (abs(built.sensor.latest().values["Fx"]) > 0) == touches)
        built.move_to({"x": 25.0, "y": -25.0, "z": 1150.0})
        built.wait_until_at_rest(10)
        assert emulated.positions() == pytest.approx({"x": 25.0, "y": -25.0, "z": 1150.0})


@pytest.mark.skipif(sys.platform == "win32", reason="no pseudo-terminals")
def test_serial_ports_become_pseudo_terminals_and_tcp_ports_stay_such(tmp_path: Path) -> None:
    config = loaded(tmp_path, rig("shot", emulate=WALL))
    with EmulatedRig(config) as emulated:
        shot = emulated.config.controllers["controller_0"]
        assert shot.address.startswith("/dev/")
        assert shot.model_copy(update={"port": "/dev/ttyUSB0"}) == config.controllers["controller_0"]
        assert emulated.config.force_sensor.address.startswith("127.0.0.1 ")
        assert loaded(tmp_path, emulated.config.dump()) == emulated.config
    with EmulatedRig(loaded(tmp_path, rig("pi_gcs"))) as emulated:
        assert emulated.config.controllers["controller_0"].address.startswith("socket://127.0.0.1:")
