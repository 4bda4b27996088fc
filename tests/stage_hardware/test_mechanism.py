"""Motions of an emulated axis, against the closed form of a trapezoid."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from stage_hardware.emulators.mechanism import Mechanism


class Now:
    """A clock that is set by hand."""

    def __init__(self) -> None:
        self.s = 100.0

    def __call__(self) -> float:
        return self.s


def axis(now: Now, position: float = 0.0, start_speed: float = 0.0) -> Mechanism:
    return Mechanism(-500, 1000, position=position, start_speed=start_speed, speed=100, acceleration=200, clock=now)


@given(target=st.floats(-499, 999), start_speed=st.floats(0, 100))
def test_a_move_takes_what_a_trapezoid_takes_and_ends_where_it_should(target: float, start_speed: float) -> None:
    now = Now()
    stage = axis(now, start_speed=start_speed)
    stage.move_to(target)
    way, ramp = abs(target), (100**2 - start_speed**2) / 400
    if way >= 2 * ramp:
        takes = 2 * (100 - start_speed) / 200 + (way - 2 * ramp) / 100
    else:
        takes = 2 * (math.sqrt(start_speed**2 + 200 * way) - start_speed) / 200
    now.s += takes / 2
    assert stage.position == pytest.approx(target / 2, abs=1e-6)
    now.s += takes / 2 + 1e-6
    assert not stage.moving
    assert stage.position == pytest.approx(target)
    assert stage.velocity == 0


def test_speed_never_exceeds_what_is_set_nor_jumps() -> None:
    now = Now()
    stage = axis(now)
    stage.move_to(800)
    last = 0.0
    while stage.moving:
        now.s += 0.001
        assert abs(stage.velocity) <= 100 + 1e-9
        assert abs(stage.velocity - last) <= 0.2 + 1e-6
        last = stage.velocity


def test_a_ramped_stop_takes_the_way_of_the_ramp_and_a_hard_one_none() -> None:
    for hard, way in ((True, 0.0), (False, 25.0)):
        now = Now()
        stage = axis(now)
        stage.move_to(800)
        now.s += 2
        there = stage.position
        stage.stop(hard=hard)
        now.s += 1
        assert not stage.moving
        assert stage.position == pytest.approx(there + way)


def test_a_switch_stops_it_and_is_told() -> None:
    now = Now()
    stage = axis(now)
    stage.jog(1)
    now.s += 60
    assert stage.position == 1000 and not stage.moving and stage.hit_limit and stage.at_upper_switch
    stage.move_to(0)
    now.s += 60
    assert stage.position == 0 and not stage.hit_limit and not stage.at_upper_switch


def test_homing_sets_the_counter_and_power_loses_it() -> None:
    now = Now()
    stage = axis(now, position=300)
    assert (stage.counter, stage.referenced) == (0, False)
    stage.home()
    assert stage.moving and not stage.referenced
    now.s += 60
    assert (stage.counter, stage.referenced, stage.position) == (0, True, 0)
    stage.move_to(50)
    now.s += 60
    stage.power_cycle()
    assert (stage.counter, stage.referenced, stage.position, stage.zero) == (0, False, 50, 50)


def test_homing_that_was_stopped_is_none() -> None:
    now = Now()
    stage = axis(now, position=300)
    stage.home()
    now.s += 0.5
    stage.stop(hard=True)
    now.s += 60
    assert not stage.referenced


def test_without_power_a_motor_does_not_move_and_a_slow_one_takes_longer() -> None:
    now = Now()
    stage = axis(now)
    stage.motor_on = False
    stage.move_to(100)
    now.s += 10
    assert stage.position == 0
    stage.motor_on, stage.slowness = True, 4.0
    stage.move_to(100)
    now.s += 2
    assert stage.moving
    now.s += 10
    assert stage.position == 100


@pytest.mark.parametrize("looks", range(5))
def test_a_home_run_that_moves_no_more_is_referenced_even_if_it_ends_between_two_looks_at_the_clock(looks: int) -> None:
    class Jumping:
        """Stands, and jumps past the end of the run after so many looks."""

        s, left = 100.0, -1

        def __call__(self) -> float:
            self.left -= 1
            if self.left == -1:
                self.s += 60
            return self.s

    now = Jumping()
    stage = Mechanism(-500, 1000, position=50, start_speed=0, speed=100, acceleration=200, clock=now)
    now.left = -2
    stage.home()
    now.left = looks
    while stage.moving:
        pass
    assert stage.referenced
