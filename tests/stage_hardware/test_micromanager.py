"""Stages of Micro-Manager: with a core made here, which can fail, and with its own devices (extra `peers`)."""

import math
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
from stage_hardware.drivers.micromanager import MicroManagerAxis, MicroManagerStage
from stage_hardware.emulators.mechanism import Mechanism
from stage_hardware.errors import HardwareError, InterruptedByStopError, LinkError, RefusedError
from stage_hardware.stage import Axis, Stage, StageState

X = Axis("um", -2_000, 2_000, 0.015, 10_000, 1e6)
Z = Axis("um", -250, 250, 0.1, 1_000, 1e6)
AXES = {
    "x": MicroManagerAxis(X, "XY", "x"),
    "y": MicroManagerAxis(X, "XY", "y"),
    "z": MicroManagerAxis(Z, "Z", knows_its_position=True),
}
CONFIGURATION = """
Device,DHub,DemoCamera,DHub
Device,XY,DemoCamera,DXYStage
Device,Z,DemoCamera,DStage
Device,Shutter,DemoCamera,DShutter
Property,Core,Initialize,1
Parent,XY,DHub
Parent,Z,DHub
Parent,Shutter,DHub
"""


class Core:
    """What is used of a core; homes are waited for, as some adapters do, and cannot be begun if ``refuses_home``."""

    def __init__(self) -> None:
        self.axes = {name: Mechanism(-3e3, 3e3, start_speed=0, speed=1e4, acceleration=1e6) for name in ("x", "y", "Z")}
        self.velocity, self.refuses_home, self.refuses_stop = "10.0000", "", ""
        self.during_move: Callable[[], None] = lambda: None

    def _of(self, device: str) -> list[Mechanism]:
        if device not in ("XY", "Z", "Shutter"):
            raise RuntimeError(f'No device with label "{device}"')
        return [self.axes["x"], self.axes["y"]] if device == "XY" else [self.axes["Z"]]

    def getDeviceType(self, device: str) -> SimpleNamespace:
        self._of(device)
        return SimpleNamespace(name={"XY": "XYStageDevice", "Z": "StageDevice", "Shutter": "ShutterDevice"}[device])

    def setProperty(self, device: str, name: str, value: str) -> None:
        self.velocity = "10.0000" if float(value) > 10 else value

    def getProperty(self, device: str, name: str) -> str:
        return self.velocity

    def deviceBusy(self, device: str) -> bool:
        return any(axis.moving for axis in self._of(device))

    def getXYPosition(self, device: str) -> list[float]:
        return [axis.counter for axis in self._of(device)]

    def getPosition(self, device: str) -> float:
        return self._of(device)[0].counter

    def setXYPosition(self, device: str, x: float, y: float) -> None:
        self.during_move()
        for axis, target in zip(self._of(device), (x, y), strict=True):
            axis.move_to(target)

    def setPosition(self, device: str, z: float) -> None:
        self._of(device)[0].move_to(z)

    def stop(self, device: str) -> None:
        if device == self.refuses_stop:
            raise RuntimeError("Unsupported device command (11)")
        for axis in self._of(device):
            axis.stop(hard=True)

    def home(self, device: str) -> None:
        if device == self.refuses_home:
            raise RuntimeError("Unsupported device command (11)")
        for axis in self._of(device):
            axis.home()
        while self.deviceBusy(device):
            time.sleep(0.002)


def made_here(_: Path) -> MicroManagerStage:
    return MicroManagerStage("microscope", AXES, core=Core())


def demonstration(folder: Path) -> MicroManagerStage:
    adapters = pytest.importorskip("mm_test_adapters", reason="mm-test-adapters is not installed")
    pytest.importorskip("pymmcore_plus", reason="pymmcore-plus is not installed")
    (folder / "demo.cfg").write_text(CONFIGURATION)
    return MicroManagerStage(
        "microscope", AXES, configuration=folder / "demo.cfg", adapter_paths=[adapters.device_adapter_path()]
    )


@pytest.fixture(params=[made_here, demonstration])
def stage(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[MicroManagerStage]:
    with request.param(tmp_path) as connected:
        connected.home(["x"])
        until(connected, stands)
        yield connected


@pytest.fixture
def core() -> Core:
    return Core()


def until(stage: Stage, holds: Callable[[StageState], bool], within_s: float = 5.0) -> StageState:
    deadline = time.monotonic() + within_s
    while not holds(state := stage.state()):
        assert time.monotonic() < deadline, state
        time.sleep(0.002)
    return state


def stands(state: StageState) -> bool:
    return not any(axis.moving for axis in state.axes.values())


def test_it_moves_to_where_it_should_and_keeps_the_axis_that_has_no_target(stage: MicroManagerStage) -> None:
    stage.move_to({"x": 300.0, "y": -150.0, "z": 20.0})
    before = time.monotonic_ns()
    state = stage.state()
    assert before <= state.time_ns <= time.monotonic_ns() and state.fault is None
    assert state.axes["x"].moving and state.axes["y"].moving
    stage.move_to({"x": 450.0})  # while y is still on its way
    state = until(stage, stands)
    for name, position in (("x", 450), ("y", -150), ("z", 20)):
        assert state.axes[name].position == pytest.approx(position, abs=0.02)


def test_a_stop_halts_it_on_the_way_and_nothing_goes_on_afterwards(stage: MicroManagerStage) -> None:
    stage.move_to({"x": 2_000.0, "y": 1_000.0})
    until(stage, lambda state: state.axes["x"].position > 50)
    stage.stop()
    state = until(stage, stands)
    assert 50 < state.axes["x"].position < 1_900
    stage.move_to({"x": 0.0})
    end = until(stage, stands)
    assert end.axes["x"].position == pytest.approx(0, abs=0.02)
    assert end.axes["y"].position == pytest.approx(state.axes["y"].position, abs=0.05)


def test_limits_hold_though_adapters_have_none(stage: MicroManagerStage) -> None:
    for target in (2_000.1, -3_000, math.nan, math.inf):
        with pytest.raises(HardwareError, match=r"microscope: x cannot go to .* um, its limits are -2000\.\.2000"):
            stage.move_to({"y": 5.0, "x": target})
    with pytest.raises(HardwareError, match="it has no axis w; there are: x, y, z"):
        stage.move_to({"w": 0.0})
    assert stage.state().axes["y"].position == pytest.approx(0, abs=0.02)


def test_targets_are_steps_within_the_limits() -> None:
    axis = MicroManagerAxis(Axis("um", -1, 1, 0.3, 1, 1), "Z")
    assert [axis.nearest(target) for target in (1, -1, 0.2, 0.1)] == pytest.approx([0.9, -0.9, 0.3, 0])
    with pytest.raises(ValueError, match="in um, got 'mm'"):
        MicroManagerAxis(Axis("mm", -1, 1, 0.3, 1, 1), "Z")


def test_what_was_not_homed_does_not_move_unless_it_knows_its_position(core: Core) -> None:
    with MicroManagerStage("microscope", AXES, core=core) as stage:
        with pytest.raises(HardwareError, match="x is not referenced; home it first"):
            stage.move_to({"x": 1.0})
        stage.move_to({"z": 1.0})
        assert [axis.referenced for axis in stage.state().axes.values()] == [False, False, True]


def test_a_home_run_that_waits_in_the_adapter_does_not_wait_here(core: Core) -> None:
    core.axes["x"] = Mechanism(-9e3, 9e3, position=5e3, start_speed=0, speed=1e4, acceleration=1e6)
    with MicroManagerStage("microscope", AXES, core=core) as stage:
        began = time.monotonic()
        stage.home(["x", "y"])
        assert time.monotonic() - began < 0.3
        state = stage.state()
        assert state.axes["x"].moving and not state.axes["x"].referenced
        state = until(stage, lambda state: state.axes["x"].referenced)
        assert stands(state) and state.axes["y"].referenced


def test_a_home_run_that_was_stopped_or_refused_is_none(core: Core) -> None:
    core.axes["x"] = Mechanism(-9e3, 9e3, position=5e3, start_speed=0, speed=1e4, acceleration=1e6)
    with MicroManagerStage("microscope", AXES, core=core) as stage:
        stage.home(["x"])
        stage.stop()
        assert not until(stage, stands).axes["x"].referenced
        core.refuses_home = "XY"
        with pytest.raises(RefusedError, match=r"cannot home XY \(Unsupported device command \(11\)\); see what"):
            stage.home(["y"])
        assert stage.state().fault == "homing XY has failed (Unsupported device command (11))"


def test_a_stop_that_comes_while_an_adapter_begins_a_move_is_not_lost(core: Core) -> None:
    with MicroManagerStage("microscope", AXES, core=core) as stage:
        stage.home(["x"])
        until(stage, stands)

        def stop_from_elsewhere() -> None:
            thread = threading.Thread(target=stage.stop)
            thread.start()
            thread.join()

        core.during_move = stop_from_elsewhere
        with pytest.raises(InterruptedByStopError):
            stage.move_to({"x": 2_000.0, "z": 100.0})
        state = stage.state()
        assert stands(state) and state.axes["z"].position == 0


def test_a_device_that_cannot_be_stopped_keeps_no_other_from_it(core: Core) -> None:
    with MicroManagerStage("microscope", AXES, core=core) as stage:
        core.refuses_stop = "XY"
        stage.move_to({"z": 200.0})
        with pytest.raises(HardwareError, match="it cannot stop XY"):
            stage.stop()
        assert stands(stage.state())
        core.refuses_stop = ""


def test_properties_are_set_and_read_back(core: Core) -> None:
    with MicroManagerStage("microscope", AXES, core=core, properties={("XY", "Velocity"): "2.0"}) as stage:
        assert core.velocity == "2.0"
    stage = MicroManagerStage("microscope", AXES, core=core, properties={("XY", "Velocity"): "99"})
    with pytest.raises(HardwareError, match=r"Velocity of XY is 10\.0000 after it was set to 99"):
        stage.connect()
    with pytest.raises(LinkError, match="not connected; connect first"):
        stage.stop()


def test_devices_that_are_no_stages_are_told(core: Core) -> None:
    for axis, match in (
        (MicroManagerAxis(Z, "XY"), "XY, the device of a, is of type XYStageDevice, not StageDevice; see to label"),
        (MicroManagerAxis(Z, "Shutter"), "is of type ShutterDevice, not StageDevice"),
        (MicroManagerAxis(Z, "nowhere"), 'Micro-Manager says No device with label "nowhere"'),
    ):
        with pytest.raises(HardwareError, match=match):
            MicroManagerStage("microscope", {"a": axis}, core=core).connect()
    with pytest.raises(ValueError, match="either a configuration or a core"):
        MicroManagerStage("microscope", AXES)


def test_without_micro_manager_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pymmcore_plus", None)
    with pytest.raises(HardwareError, match=r"pymmcore-plus is not installed; pip install 'neurorobo-.*\[mm\]'"):
        MicroManagerStage("microscope", AXES, configuration=Path("none.cfg")).connect()


def test_the_demonstration_has_its_own_refusals(tmp_path: Path) -> None:
    wide = {"z": MicroManagerAxis(Axis("um", -900, 900, 0.1, 1, 1), "Z", knows_its_position=True)}
    stage = demonstration(tmp_path)
    with stage:
        stage.home(["x"])
        with pytest.raises(RefusedError, match="cannot home Z"):
            stage.home(["z"])
        core = stage._core
        with pytest.raises(RefusedError, match="Position out of range"):
            also = MicroManagerStage("microscope", wide, core=core)
            also.connect()
            also.move_to({"z": 800.0})
        also.close()
        assert stage.state().axes["z"].position == 0  # a core that was given is left loaded
    stage.close()
    missing = MicroManagerStage("microscope", AXES, configuration=tmp_path / "missing.cfg")
    with pytest.raises(HardwareError, match=r"Micro-Manager says .*missing\.cfg"):
        missing.connect()
