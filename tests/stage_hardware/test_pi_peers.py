"""PIPython, PI's own library, on the emulator; and as a stage. It is installed by the extra `peers`."""

import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from stage_hardware.drivers.pi_gcs import PiAxis, Reference
from stage_hardware.drivers.pipython_stage import PipythonStage, open_device
from stage_hardware.emulators.pi_gcs import EmulatedStage, PiEmulator
from stage_hardware.emulators.wire import PseudoTerminal, TcpPort
from stage_hardware.errors import HardwareError, LinkError, RefusedError, ReplyTimeoutError
from stage_hardware.stage import Axis, Stage, StageState

pipython = pytest.importorskip("pipython", reason="PIPython is not installed")

WIRES = [TcpPort] if sys.platform == "win32" else [TcpPort, PseudoTerminal]
STAGES = {"1": EmulatedStage(position=0.2), "2": EmulatedStage(position=-0.1)}
X = Axis("um", -10_000, 10_000, 0.1, 10_000, 200_000)
AXES = {"x": PiAxis(X, "1"), "y": PiAxis(X, "2", Reference.LOWER_LIMIT)}


@pytest.fixture(params=WIRES)
def emulator(request: pytest.FixtureRequest) -> Iterator[PiEmulator]:
    with PiEmulator(STAGES, wire=request.param) as running:
        yield running


@pytest.fixture
def device(emulator: PiEmulator) -> Iterator[Any]:
    with open_device(emulator.url) as opened:  # type: ignore[attr-defined]
        yield opened


@pytest.fixture
def stage(emulator: PiEmulator) -> Iterator[PipythonStage]:
    made = PipythonStage("table", lambda: open_device(emulator.url), AXES, timeout_s=0.3, identity="C-863")
    with made:
        made.home(["x"])
        until(made, stands)
        yield made


def until(stage: Stage, holds: Callable[[StageState], bool], within_s: float = 5.0) -> StageState:
    deadline = time.monotonic() + within_s
    while not holds(state := stage.state()):
        assert time.monotonic() < deadline, state
    return state


def stands(state: StageState) -> bool:
    return not any(axis.moving for axis in state.axes.values())


def wait(device: Any) -> None:
    deadline = time.monotonic() + 5
    while any(device.IsMoving().values()) or not device.IsControllerReady():
        assert time.monotonic() < deadline


def test_it_finds_the_controller_its_axes_and_its_limits(device: Any) -> None:
    assert "C-863.11" in device.qIDN()
    assert device.axes == ["1", "2"]
    assert device.qCSV() == "2.0" or float(device.qCSV()) == 2.0
    assert dict(device.qTMN()) == {"1": -12.5, "2": -12.5} and dict(device.qTMX()) == {"1": 12.5, "2": 12.5}
    assert device.qCST()["1"] == "M-112.1DG"
    assert device.HasFRF() and device.HasATZ() and device.HasqPOS() and not device.HasSTE()


def test_it_references_moves_and_reads_both_axes(device: Any) -> None:
    device.SVO(["1", "2"], [True, True])
    device.VEL({"1": 10, "2": 8})
    assert dict(device.qVEL()) == {"1": 10, "2": 8}
    device.FRF(["1"])
    device.RON("2", 0)
    device.POS("2", 3)
    wait(device)
    assert dict(device.qFRF()) == {"1": True, "2": True}
    device.MOV({"1": 1.25, "2": 2.5})
    assert device.IsMoving()["1"]
    assert not device.qONT()["1"]
    wait(device)
    assert dict(device.qPOS()) == {"1": 1.25, "2": 2.5} == dict(device.qMOV())
    assert all(device.qONT().values())
    assert device.GetStatus() == 0x9002_9000  # the second stands below its reference switch


def test_it_is_told_errors_by_their_codes(device: Any) -> None:
    with pytest.raises(pipython.GCSError) as raised:
        device.MOV("1", 1)
    assert raised.value.val == 5
    device.SVO("1", True)
    device.FNL("1")
    device.StopAll(noraise=True)
    assert not device.qFRF()["1"]
    device.FRF("1")
    wait(device)
    for code, call in ((7, lambda: device.MOV("1", 20)), (8, lambda: device.VEL("1", 99)), (10, device.StopAll)):
        with pytest.raises(pipython.GCSError) as raised:
            call()
        assert raised.value.val == code
    with pytest.raises(pipython.GCSError) as raised:
        device.HLT("1")
    assert raised.value.val == 10


def test_its_own_start_up_runs_through(device: Any) -> None:
    from pipython import pitools

    pitools.startup(device, stages=None, refmodes=["FRF", "FNL"])
    assert all(device.qFRF().values()) and all(device.qSVO().values())
    pitools.waitontarget(device)
    device.MOV("1", 0.5)
    pitools.waitontarget(device)
    assert device.qPOS()["1"] == 0.5


def test_as_a_stage_it_homes_moves_and_stops(stage: PipythonStage) -> None:
    with pytest.raises(HardwareError, match="y is not referenced"):
        stage.move_to({"y": 0.0})
    stage.move_to({"x": 100.0})
    assert until(stage, stands).axes["x"].position == pytest.approx(100)
    stage.move_to({"x": 10_000.0})
    until(stage, lambda state: state.axes["x"].position > 500)
    stage.stop()
    state = until(stage, stands)
    assert state.axes["x"].position < 9_000 and state.fault is None
    stage.move_to({"x": 0.0})
    assert until(stage, stands).axes["x"].position == pytest.approx(0, abs=0.1)


def test_as_a_stage_it_stops_while_an_answer_is_awaited(stage: PipythonStage, emulator: PiEmulator) -> None:
    stage.move_to({"x": 10_000.0})
    emulator.faults.no_reply = 1
    raised: list[HardwareError] = []

    def poll() -> None:
        try:
            stage.state()
        except HardwareError as error:
            raised.append(error)

    thread = threading.Thread(target=poll)
    thread.start()
    time.sleep(0.05)
    began = time.monotonic()
    stage.stop()
    assert time.monotonic() - began < 0.15
    thread.join()
    assert isinstance(raised[0], ReplyTimeoutError)
    assert until(stage, stands).axes["x"].position < 9_000


def test_as_a_stage_it_tells_refusals_and_power_cycles(stage: PipythonStage, emulator: PiEmulator) -> None:
    emulator.axes["1"].joystick = True
    with pytest.raises(RefusedError, match="joystick"):
        stage.move_to({"x": 100.0})
    emulator.power_cycle()
    assert "power cycle" in str(stage.state().fault)
    stage.connect()
    assert stage.state().fault is None


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # PIPython leaves such a socket open
def test_as_a_stage_it_tells_that_the_line_is_gone(stage: PipythonStage, emulator: PiEmulator) -> None:
    emulator.faults.hang_up = True
    time.sleep(0.1)
    with pytest.raises(HardwareError):
        stage.state()
    stage.close()
    with pytest.raises(LinkError, match="not connected"):
        stage.state()
    stage._line.stop_all = lambda: None  # type: ignore[method-assign]  # what the end of the fixture would raise
