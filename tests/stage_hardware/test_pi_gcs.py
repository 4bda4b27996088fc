"""The driver of PI controllers against their emulator: what it promises, and what it does when things go wrong."""

import math
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping

import pytest
from hypothesis import given
from hypothesis import strategies as st
from stage_hardware.drivers.pi_gcs import PiAxis, PiStage, Reference
from stage_hardware.drivers.pipython_stage import PipythonStage, open_device
from stage_hardware.emulators.pi_gcs import EmulatedStage, PiEmulator
from stage_hardware.emulators.wire import PseudoTerminal, TcpPort
from stage_hardware.errors import (
    HardwareError,
    InterruptedByStopError,
    LinkError,
    RefusedError,
    ReplyError,
    ReplyTimeoutError,
)
from stage_hardware.stage import Axis, Stage, StageState

WIRES = [TcpPort] if sys.platform == "win32" else [TcpPort, PseudoTerminal]
X = Axis("um", -10_000, 10_000, 0.1, 10_000, 200_000)
TURN = Axis("mdeg", -5_000, 5_000, 1, 8_000, 200_000)
STAGES = {"1": EmulatedStage(position=0.2), "2": EmulatedStage(position=-0.1, resolution=1e-3)}
AXES = {"x": PiAxis(X, "1"), "turn": PiAxis(TURN, "2")}


def until(stage: Stage, holds: Callable[[StageState], bool], within_s: float = 5.0) -> StageState:
    deadline = time.monotonic() + within_s
    while not holds(state := stage.state()):
        assert time.monotonic() < deadline, state
    return state


def stands(state: StageState) -> bool:
    return not any(axis.moving for axis in state.axes.values())


def driver(emulator: PiEmulator, axes: Mapping[str, PiAxis] = AXES, timeout_s: float = 0.3) -> PiStage:
    return PiStage("table", emulator.url, axes, timeout_s=timeout_s, identity="C-863")


@pytest.fixture(params=WIRES)
def emulator(request: pytest.FixtureRequest) -> Iterator[PiEmulator]:
    with PiEmulator(STAGES, wire=request.param) as running:
        yield running


@pytest.fixture
def stage(emulator: PiEmulator) -> Iterator[PiStage]:
    """One that is connected and homed, with no time lost on either."""
    with driver(emulator) as connected:
        connected.home(AXES)
        until(connected, stands)
        yield connected


def test_connecting_moves_nothing_and_sets_what_a_power_cycle_loses(emulator: PiEmulator) -> None:
    with driver(emulator) as stage:
        state = stage.state()
        assert stands(state) and state.fault is None
        assert not any(axis.referenced for axis in state.axes.values())
        assert emulator.axes["1"].mechanism.position == 0.2
        assert emulator.axes["1"].servo_on and emulator.axes["2"].servo_on
        assert (emulator.axes["1"].speed, emulator.axes["2"].speed) == (10, 8)
        assert emulator.axes["1"].mechanism.acceleration == emulator.axes["1"].deceleration == 200


def test_what_was_connected_is_checked(emulator: PiEmulator) -> None:
    wide = {"x": PiAxis(Axis("um", -13_000, 10_000, 0.1, 1000, 1000), "1")}
    for made, match in (
        (driver(emulator, {"x": PiAxis(X, "3")}), "table: x is axis 3, and there are: 1, 2; see to the identifiers"),
        (driver(emulator, wide), "the limits of x, -13000..10000 um, are wider than the controller's, -12500..12500"),
        (PiStage("table", emulator.url, AXES, identity="C-884"), "'C-884' is missing; see which port it is on"),
        (driver(emulator, {"x": PiAxis(Axis("um", 0, 1, 0.1, 20_000, 1000))}), "a velocity is beyond the limits"),
    ):
        with pytest.raises(HardwareError, match=match):
            made.connect()
        with pytest.raises(LinkError, match="not connected"):
            made.state()
        made.close()
    with pytest.raises(ValueError, match="in um or mdeg, got 'mm'"):
        PiAxis(Axis("mm", 0, 1, 0.1, 1, 1))


def test_a_move_before_homing_is_refused_and_after_it_arrives(emulator: PiEmulator) -> None:
    with driver(emulator) as stage:
        with pytest.raises(HardwareError, match="x is not referenced; home it first"):
            stage.move_to({"x": 100.0})
        stage.home(["x"])
        with pytest.raises(HardwareError, match="x is not referenced"):
            stage.move_to({"x": 100.0})
        state = until(stage, stands)
        assert state.axes["x"].referenced and not state.axes["turn"].referenced
        assert state.axes["x"].position == pytest.approx(0, abs=0.1)
        stage.move_to({"x": 100.0})
        assert until(stage, stands).axes["x"].position == pytest.approx(100)
        assert not any(command.startswith("MVR") for command in emulator.heard)


@pytest.mark.parametrize(
    ("reference", "position"),
    [
        (Reference.SWITCH, 0),
        (Reference.LOWER_LIMIT, -13_000),
        (Reference.UPPER_LIMIT, 13_000),
        (Reference.DECLARED, 250),
        (Reference.AUTOMATIC_ZERO, 0),
    ],
)
def test_every_way_of_referencing_ends_at_its_place(reference: Reference, position: float) -> None:
    where = math.copysign(12.9, position) if abs(position) > 10_000 else 0.3
    axis = PiAxis(X, "1", reference, declared=250)
    with PiEmulator({"1": EmulatedStage(position=where)}) as emulator, driver(emulator, {"x": axis}) as stage:
        stage.home(["x"])
        state = until(stage, lambda state: state.axes["x"].referenced)
        assert state.axes["x"].position == pytest.approx(position) and stands(state)
        assert state.axes["x"].at_lower_limit is (reference is Reference.LOWER_LIMIT)
        assert state.axes["x"].at_upper_limit is (reference is Reference.UPPER_LIMIT)
        assert state.fault is None
        stage.move_to({"x": math.copysign(9_950, position) if abs(position) > 10_000 else 20})


def test_targets_beyond_limits_and_axes_that_are_none_are_refused(stage: PiStage, emulator: PiEmulator) -> None:
    for target in (10_000.1, -10_001, math.nan, math.inf):
        with pytest.raises(HardwareError, match=r"table: x cannot go to .* um, its limits are -10000\.\.10000; stay"):
            stage.move_to({"turn": 0.0, "x": target})
    with pytest.raises(HardwareError, match="it has no axis y; there are: x, turn"):
        stage.move_to({"y": 0.0})
    with pytest.raises(HardwareError, match="it has no axis y"):
        stage.home(["y"])
    assert not any(command.startswith("MOV ") for command in emulator.heard)


@given(position=st.floats(-10_000, 10_000), resolution=st.sampled_from([0.1, 0.05, 0.25, 1.0, 0.3]))
def test_targets_go_out_as_the_nearest_step_exactly(position: float, resolution: float) -> None:
    axis = Axis("um", -10_000, 10_000, resolution, 1, 1)
    sent = float(PiAxis(axis).controller_value(position)) * 1000
    assert abs(sent - position) <= resolution * (0.5 + 1e-6) or abs(position) > 10_000 - resolution
    assert sent / resolution == pytest.approx(round(sent / resolution), abs=1e-6)
    assert axis.lo - 1e-9 <= sent <= axis.hi + 1e-9


def test_states_know_their_time_and_that_an_axis_moves(stage: PiStage) -> None:
    stage.move_to({"x": 3_000.0, "turn": -2_000.0})
    before = time.monotonic_ns()
    state = stage.state()
    assert before <= state.time_ns <= time.monotonic_ns()
    assert state.axes["x"].moving and state.axes["turn"].moving
    last = until(stage, stands)
    assert last.axes["x"].position == pytest.approx(3_000) and last.axes["turn"].position == pytest.approx(-2_000)


def test_a_stop_halts_all_axes_on_the_way_and_the_next_move_is_free(stage: PiStage) -> None:
    stage.move_to({"x": 10_000.0, "turn": 5_000.0})
    until(stage, lambda state: state.axes["x"].position > 500)
    stage.stop()
    state = until(stage, stands)
    assert 500 < state.axes["x"].position < 9_000 and state.fault is None
    time.sleep(0.1)
    assert stage.state().axes["x"].position == state.axes["x"].position
    stage.move_to({"x": 0.0})
    assert until(stage, stands).axes["x"].position == pytest.approx(0, abs=0.1)


def test_a_stop_does_not_wait_for_an_answer_that_does_not_come(stage: PiStage, emulator: PiEmulator) -> None:
    stage.move_to({"x": 10_000.0})
    emulator.faults.no_reply = 1
    raised: list[HardwareError] = []

    def poll() -> None:
        try:
            for _ in range(100):
                stage.state()
        except HardwareError as error:
            raised.append(error)

    stage._line._link.timeout_s = 3.0  # type: ignore[attr-defined]
    thread = threading.Thread(target=poll)
    thread.start()
    time.sleep(0.1)
    began = time.monotonic()
    stage.stop()
    assert time.monotonic() - began < 0.15
    thread.join()
    stage._line._link.timeout_s = 0.3  # type: ignore[attr-defined]
    assert isinstance(raised[0], InterruptedByStopError)
    assert until(stage, stands).axes["x"].position < 9_000


def test_homing_that_was_stopped_is_none(emulator: PiEmulator) -> None:
    emulator.axes["1"].mechanism.slowness = 20
    with driver(emulator) as stage:
        stage.home(["x"])
        assert stage.state().axes["x"].moving
        stage.stop()
        assert not until(stage, stands).axes["x"].referenced
        with pytest.raises(HardwareError, match="not referenced"):
            stage.move_to({"x": 0.0})


def test_a_refusal_is_told_in_words(stage: PiStage, emulator: PiEmulator) -> None:
    emulator.axes["1"].joystick = True
    with pytest.raises(RefusedError, match=r"is refused: the axis is under the control of a joystick \(error 51\); sw"):
        stage.move_to({"x": 100.0})
    emulator.axes["1"].joystick = False
    emulator.refuse_next = 999
    with pytest.raises(RefusedError, match=r"a fault that this driver does not know \(error 999\); look the code up"):
        stage.move_to({"x": 100.0})
    stage.move_to({"x": 100.0})
    assert until(stage, stands).axes["x"].position == pytest.approx(100)


def test_a_limit_switch_in_the_middle_of_a_move_is_a_fault_until_the_next_one(
    stage: PiStage, emulator: PiEmulator
) -> None:
    emulator.axes["1"].mechanism.upper_switch = 1.0
    stage.move_to({"x": 3_000.0})
    state = until(stage, stands)
    assert state.axes["x"].at_upper_limit and state.axes["x"].position == pytest.approx(1_000, abs=1)
    assert state.fault == "an axis has run onto a limit switch (error 216)" == stage.state().fault
    stage.move_to({"x": 0.0})
    state = until(stage, stands)
    assert state.fault is None and not state.axes["x"].at_upper_limit


def test_switches_of_the_other_sense_are_told_alike(emulator: PiEmulator) -> None:
    emulator.axes["1"].limits_inverted = True
    with driver(emulator, {"x": PiAxis(X, "1", limits_inverted=True)}) as stage:
        axis = stage.state().axes["x"]
        assert not axis.at_lower_limit and not axis.at_upper_limit


def test_a_servo_that_fails_is_a_fault_and_refuses_moves(stage: PiStage, emulator: PiEmulator) -> None:
    stage.move_to({"x": 5_000.0})
    emulator.switch_servo_off("1")
    state = until(stage, stands)
    assert state.fault is not None
    assert "the servo has been switched off (error -1024)" in state.fault and "the servo of x is off" in state.fault
    with pytest.raises(RefusedError, match=r"its servo is off \(error 5\)"):
        stage.move_to({"x": 0.0})


def test_a_power_cycle_is_noticed_and_connecting_again_sets_all_anew(stage: PiStage, emulator: PiEmulator) -> None:
    stage.move_to({"x": 500.0})
    until(stage, stands)
    emulator.power_cycle()
    with pytest.raises(HardwareError, match=r"\(error 5\)"):
        stage.move_to({"x": 100.0})
    state = stage.state()
    assert state.fault is not None and "power cycle" in state.fault
    assert not state.axes["x"].referenced
    stage.connect()
    assert stage.state().fault is None
    assert emulator.axes["1"].speed == 10 and emulator.axes["1"].servo_on
    assert not stage.state().axes["x"].referenced


def test_an_axis_that_does_not_reach_its_target_still_moves(stage: PiStage, emulator: PiEmulator) -> None:
    emulator.axes["1"].off_target = 0.005
    stage.move_to({"x": 100.0})
    until(stage, lambda state: not emulator.axes["1"].mechanism.moving)
    assert stage.state().axes["x"].moving
    emulator.axes["1"].off_target = 0.0
    assert stands(stage.state())


def test_slow_motion_takes_longer(stage: PiStage, emulator: PiEmulator) -> None:
    emulator.axes["1"].mechanism.slowness = 1000
    stage.move_to({"x": 2_000.0})
    time.sleep(0.3)
    assert stage.state().axes["x"].moving
    stage.stop()


def test_after_a_lost_answer_the_state_is_read_before_the_next_command(stage: PiStage, emulator: PiEmulator) -> None:
    emulator.faults.no_reply = 1
    with pytest.raises(ReplyTimeoutError, match="no reply to 'MOV 1"):
        stage.move_to({"x": 400.0})
    heard = len(emulator.heard)
    assert sum(command.startswith("MOV ") for command in emulator.heard) == 1  # none is repeated by itself
    stage.move_to({"x": 400.0})
    after = list(emulator.heard)[heard:]
    assert after.index("POS? 1 2") < after.index("MOV 1 0.4")
    assert until(stage, stands).axes["x"].position == pytest.approx(400)


def test_a_late_answer_is_not_taken_for_another(stage: PiStage, emulator: PiEmulator) -> None:
    emulator.faults.late_reply, emulator.faults.late_s = 1, 0.45
    with pytest.raises(ReplyTimeoutError):
        stage.state()
    assert stage.state().axes["x"].position == pytest.approx(0, abs=0.1)


def test_answers_in_pieces_are_read(stage: PiStage, emulator: PiEmulator) -> None:
    emulator.faults.split_reply = 20
    stage.move_to({"x": 10.0, "turn": 10.0})
    assert until(stage, stands).axes["x"].position == pytest.approx(10)


@pytest.mark.parametrize("which", range(3))
def test_a_garbled_answer_is_told_and_the_next_is_right(stage: PiStage, emulator: PiEmulator, which: int) -> None:
    """Each of the three answers of which a state is made: registers, positions, references."""
    asked = emulator.answer
    emulator.wire.answer = lambda data: asked(data)
    replies = 0
    original = emulator.wire._reply

    def reply(data: bytes) -> None:
        nonlocal replies
        if replies == which:
            emulator.faults.garbled_reply = 1
        replies += 1
        original(data)

    emulator.wire._reply = reply  # type: ignore[method-assign]
    with pytest.raises(ReplyError, match="does not answer"):
        stage.state()
    assert stage.state().axes["x"].position == pytest.approx(0, abs=0.1)


def test_a_wrong_terminator_is_silence(stage: PiStage, emulator: PiEmulator) -> None:
    emulator.faults.wrong_terminator = 1
    with pytest.raises(ReplyTimeoutError):
        stage.state()
    assert stage.state().fault is None


def test_a_pulled_cable_is_told_apart_and_closing_is_safe(stage: PiStage, emulator: PiEmulator) -> None:
    emulator.faults.hang_up = True
    with pytest.raises(LinkError, match="is gone"):
        for _ in range(20):
            stage.state()
    with pytest.raises(LinkError):
        for _ in range(20):
            stage.stop()
            time.sleep(0.02)
    stage.close()
    stage.close()
    emulator.faults.hang_up = False
    stage._line.stop_all = lambda: None  # type: ignore[method-assign]  # what the end of the fixture would raise


def test_without_the_register_each_is_asked(emulator: PiEmulator) -> None:
    stage = PiStage("table", emulator.url, AXES, timeout_s=0.3, status_bits=None)
    with stage:
        stage.home(AXES)
        assert stage.state().axes["x"].moving
        until(stage, stands)
        stage.move_to({"turn": 1_000.0})
        state = stage.state()
        assert state.axes["turn"].moving and not state.axes["x"].moving
        assert until(stage, stands).axes["turn"].position == pytest.approx(1_000)
        emulator.switch_servo_off("2")
        assert "-1024" in str(stage.state().fault)
    assert "#4" not in emulator.heard


def test_without_pipython_its_stage_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pipython", None)
    stage = PipythonStage("table", lambda: open_device("socket://127.0.0.1:1"), AXES)
    with pytest.raises(HardwareError, match=r"pipython is not installed; pip install 'neurorobo-stage-hardware\[pi\]'"):
        stage.connect()
    with pytest.raises(LinkError, match="not connected; connect first"):
        stage.stop()


@pytest.mark.skipif(sys.platform == "win32", reason="there are no pseudo-terminals")
def test_the_line_is_set_as_documented() -> None:
    with PiEmulator(wire=PseudoTerminal) as emulator:
        stage = PiStage("table", emulator.url, {"x": PiAxis(X)}, baud=38400)
        with stage:
            assert emulator.wire.settings == (38400, False)  # type: ignore[attr-defined]


def test_a_state_costs_little_more_than_the_wire() -> None:
    with PiEmulator(baud=115200) as emulator, driver(emulator, {"x": PiAxis(X)}) as stage:
        stage.state()
        took_s = min(_time_of(stage.state) for _ in range(30))
    wire_s = (1 + 7 + 7 + 12 + 7 + 4) * 10 / 115200
    assert took_s < 3 * wire_s


def _time_of(call: Callable[[], object]) -> float:
    began = time.monotonic()
    call()
    return time.monotonic() - began
