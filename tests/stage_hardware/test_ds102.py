"""The driver of the DS102 and its emulator, each written from the tables without a look at the other."""

import time
from collections.abc import Callable, Iterator
from fractions import Fraction

import pytest
from stage_hardware.drivers.ds102 import DS102Axis, DS102Stage
from stage_hardware.emulators.ds102 import DS102Emulator
from stage_hardware.errors import HardwareError
from stage_hardware.stage import Axis, StageState

X = DS102Axis(Axis("um", -5000, 5000, 2.0, 2000.0, 20_000.0), 1, Fraction(1, 2), origin_type=3)


@pytest.fixture
def emulator() -> Iterator[DS102Emulator]:
    with DS102Emulator(processing_s=0.002) as emulator:
        yield emulator


@pytest.fixture
def stage(emulator: DS102Emulator) -> Iterator[DS102Stage]:
    with DS102Stage("rig", emulator.url, {"x": X}, timeout_s=2.0) as stage:
        yield stage


def until(stage: DS102Stage, holds: Callable[[StageState], bool]) -> StageState:
    deadline = time.monotonic() + 20
    while not holds(state := stage.state()):
        assert time.monotonic() < deadline, state
        time.sleep(0.01)
    return state


def rests(state: StageState) -> bool:
    return not state.axes["x"].moving


def homed(stage: DS102Stage) -> DS102Stage:
    stage.home(["x"])
    assert until(stage, rests).axes["x"].referenced
    return stage


def test_an_axis_finds_its_origin_and_goes_where_it_is_sent(stage: DS102Stage, emulator: DS102Emulator) -> None:
    assert not stage.state().axes["x"].referenced
    homed(stage)
    for target in (400.0, -250.0, 0.0):
        stage.move_to({"x": target})
        state = until(stage, rests)
        assert (state.axes["x"].position, state.fault) == (target, None)
        assert emulator.axes[0].counter == pytest.approx(target / 2)


def test_a_stop_ends_a_motion_on_its_way(stage: DS102Stage, emulator: DS102Emulator) -> None:
    homed(stage)
    emulator.axes[0].slowness = 10
    stage.move_to({"x": 4000.0})
    until(stage, lambda state: state.axes["x"].position > 0)
    stage.stop()
    assert 0 < until(stage, rests).axes["x"].position < 4000
    assert not emulator.axes[0].moving


def test_a_power_cycle_takes_the_reference(stage: DS102Stage, emulator: DS102Emulator) -> None:
    homed(stage)
    emulator.power_cycle()
    state = stage.state()
    assert state.fault is not None and not state.axes["x"].referenced
    with pytest.raises(HardwareError, match="home"):
        stage.move_to({"x": 10.0})


def test_what_the_controller_refuses_is_told_by_its_code(stage: DS102Stage, emulator: DS102Emulator) -> None:
    homed(stage)
    emulator.refusals.append("E02")
    with pytest.raises(HardwareError, match="E02"):
        stage.move_to({"x": 10.0})
