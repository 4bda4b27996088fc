"""Latencies, by a clock that is set by hand."""

import pytest

from neurorobo.bodies.latencies import Latencies


class Clock:
    """Time passes when it is told to."""

    def __init__(self) -> None:
        self.ns = 7

    def __call__(self) -> int:
        return self.ns

    def work(self, ms: float) -> None:
        self.ns += round(ms * 1e6)


def test_figures_are_those_of_the_periods() -> None:
    clock = Clock()
    latencies = Latencies(clock)
    assert latencies.figures() == {"periods": 0, "latency_ms": {}, "histogram_ms": []}
    for ms in [1.0] * 98 + [20.0, 30.0]:
        latencies.sensed()
        clock.work(ms)
        latencies.commanded()
        assert latencies.latest_ms == ms
        clock.work(100)
    figures = latencies.figures()
    assert figures["periods"] == 100
    assert figures["latency_ms"] == pytest.approx({"p50": 1.0, "p99": 20.1, "max": 30.0})
    histogram = dict(figures["histogram_ms"])
    assert sum(histogram.values()) == 100 and histogram[1.0] == 98
    assert max(histogram) >= 30.0


def test_the_last_word_of_a_period_counts() -> None:
    clock = Clock()
    latencies = Latencies(clock)
    for sent_after_ms in (2.0, 3.0):
        latencies.sensed()
        clock.work(1)
        latencies.commanded()
        clock.work(sent_after_ms)
        latencies.commanded()
        assert latencies.latest_ms == 1 + sent_after_ms
    assert latencies.figures()["periods"] == 2
