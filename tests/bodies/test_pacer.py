"""Periods on a grid of the clock, with a clock that is set by hand and once with the real one."""

import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from neurorobo.bodies.pacer import MissedDeadlineError, Overrun, Pacer

PERIOD_NS = 50_000_000


class Clock:
    """Time passes while something sleeps, and when it is told to."""

    def __init__(self) -> None:
        self.ns = 7

    def __call__(self) -> int:
        return self.ns

    def sleep(self, seconds: float) -> None:
        self.ns += round(seconds * 1e9)

    def work(self, ms: float) -> None:
        self.ns += round(ms * 1e6)


def paced(overrun: Overrun) -> tuple[Pacer, Clock]:
    clock = Clock()
    return Pacer(overrun, clock=clock, sleep=clock.sleep), clock


@given(work_ms=st.lists(st.floats(0, 49.9), min_size=1, max_size=50))
def test_periods_that_are_in_time_end_on_the_grid(work_ms: list[float]) -> None:
    pacer, clock = paced("stop")
    began = clock.ns
    for number, ms in enumerate(work_ms, 1):
        clock.work(ms)
        pacer.wait(PERIOD_NS)
        assert clock.ns == began + number * PERIOD_NS
    assert (pacer.periods, pacer.overruns, pacer.skipped) == (len(work_ms), 0, 0)


def test_a_missed_deadline_stops_by_its_number_and_how_late_it_is() -> None:
    pacer, clock = paced("stop")
    clock.work(10)
    pacer.wait(PERIOD_NS)
    clock.work(62.5)
    with pytest.raises(MissedDeadlineError, match=r"period 2 of 50 ms ended 12\.5 ms late: the body was stopped"):
        pacer.wait(PERIOD_NS)


def test_held_periods_catch_up_on_the_grid() -> None:
    pacer, clock = paced("hold")
    ends = []
    for ms in (120, 10, 10, 10):
        clock.work(ms)
        pacer.wait(PERIOD_NS)
        ends.append((clock.ns - 7) / 1e6)
    assert ends == [120, 130, 150, 200]
    assert (pacer.overruns, pacer.skipped) == (2, 0)
    assert [((due_ns - 7) / 1e6, late_ns / 1e6) for due_ns, late_ns in pacer.late] == [(50, 70), (100, 30)]


def test_skipped_periods_are_left_out() -> None:
    pacer, clock = paced("skip")
    ends = []
    for ms in (120, 10, 50, 10):
        clock.work(ms)
        pacer.wait(PERIOD_NS)
        ends.append((clock.ns - 7) / 1e6)
    assert ends == [150, 200, 250, 300]
    assert (pacer.periods, pacer.overruns, pacer.skipped) == (4, 1, 2)


def test_by_the_real_clock_no_delay_adds_up() -> None:
    pacer = Pacer("hold")
    pacer.start()
    began = time.monotonic()
    for _ in range(20):
        pacer.wait(5_000_000)
    assert 0.1 <= time.monotonic() - began < 0.5
