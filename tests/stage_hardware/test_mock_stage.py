"""The stage without a wire keeps the contract, and fails when it is told to."""

import pytest
from stage_hardware.emulators.mock_stage import MockStage
from stage_hardware.errors import HardwareError, LinkError, RefusedError, ReplyTimeoutError
from stage_hardware.stage import Axis, StageState

AXES = {"x": Axis("um", -1000, 1000, 0.5, 500, 5000), "turn": Axis("mdeg", 0, 90_000, 2.5, 10_000, 100_000)}


class Now:
    """A clock that is set by hand."""

    def __init__(self) -> None:
        self.s = 100.0

    def __call__(self) -> float:
        return self.s


def rest(stage: MockStage, now: Now) -> StageState:
    now.s += 100
    return stage.state()


def homed(now: Now) -> MockStage:
    stage = MockStage("m", AXES, clock=now)
    stage.connect()
    stage.home(AXES)
    assert all(axis.moving for axis in stage.state().axes.values())
    assert all(axis.referenced and not axis.moving for axis in rest(stage, now).axes.values())
    return stage


def test_it_goes_to_the_nearest_step_and_takes_its_time() -> None:
    now = Now()
    stage = homed(now)
    stage.move_to({"x": 499.7, "turn": 1000})
    now.s += 0.5
    state = stage.state()
    assert state.axes["x"].moving and 0 < state.axes["x"].position < 499.7
    assert state.age_ns(int((now.s + 2) * 1e9)) == pytest.approx(2e9)
    state = rest(stage, now)
    assert (state.axes["x"].position, state.axes["turn"].position, state.fault) == (499.5, 1000, None)


def test_it_refuses_what_is_not_safe() -> None:
    now = Now()
    stage = MockStage("m", AXES, clock=now)
    with pytest.raises(LinkError, match="not connected; connect first"):
        stage.state()
    stage.connect()
    with pytest.raises(HardwareError, match="axis x does not know where it is; home it first"):
        stage.move_to({"x": 0})
    stage = homed(now)
    with pytest.raises(HardwareError, match=r"turn would go to -1 mdeg; stay within 0\.\.90000 mdeg"):
        stage.move_to({"turn": -1, "x": 5})
    assert not any(axis.moving for axis in stage.state().axes.values())


def test_a_stop_is_at_once_and_the_position_stays_known() -> None:
    now = Now()
    stage = homed(now)
    stage.move_to({"x": 1000})
    now.s += 0.7
    there = stage.state().axes["x"].position
    stage.stop()
    state = rest(stage, now)
    assert (state.axes["x"].position, state.axes["x"].referenced) == (there, True)


def test_it_fails_as_told() -> None:
    now = Now()
    stage = homed(now)
    stage.refusals = 1
    with pytest.raises(RefusedError):
        stage.move_to({"x": 1})
    stage.mechanisms["x"].motor_on = False
    with pytest.raises(RefusedError, match="motor of axis x is off"):
        stage.move_to({"turn": 10, "x": 1})
    assert rest(stage, now).axes["turn"].position == 0
    stage.mechanisms["x"].motor_on, stage.silent = True, True
    with pytest.raises(ReplyTimeoutError):
        stage.state()
    stage.silent, stage.mechanisms["x"].upper_switch = False, 100
    stage.move_to({"x": 1000})
    state = rest(stage, now)
    assert state.axes["x"].at_upper_limit and state.axes["x"].position == 100 and "limit switch" in str(state.fault)
    stage.power_cycle()
    state = rest(stage, now)
    assert not any(axis.referenced for axis in state.axes.values()) and "off and on" in str(state.fault)
    stage.home(["x"])
    assert rest(stage, now).axes["x"].referenced and stage.state().fault is None
    stage.unplugged = True
    for call in (stage.state, stage.stop, stage.connect):
        with pytest.raises(LinkError):
            call()
    stage.close()
    stage.close()
