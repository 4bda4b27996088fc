"""How long it takes from the sensors to the commands, period by period."""

import time
from array import array
from collections.abc import Callable
from typing import Any

import numpy as np

BINS_PER_DECADE = 10


class Latencies:
    """Keeps how long each period took to answer, in nanoseconds of a clock that never goes back. For one thread."""

    def __init__(self, clock: Callable[[], int] = time.monotonic_ns) -> None:
        """Know of no period yet; ``clock`` counts nanoseconds."""
        self._clock = clock
        self._sensed_ns = clock()
        self._is_answered = True
        self._ns = array("q")

    def sensed(self) -> None:
        """Note that the sensors are about to be read: a period's latency counts from here."""
        self._sensed_ns, self._is_answered = self._clock(), False

    def commanded(self) -> None:
        """Note that the commands are out; of several times in one period, the last one counts."""
        latency_ns = self._clock() - self._sensed_ns
        if self._is_answered and self._ns:
            self._ns[-1] = latency_ns
        else:
            self._ns.append(latency_ns)
        self._is_answered = True

    @property
    def latest_ms(self) -> float:
        """The latency of the last period that was answered; 0 before the first."""
        return self._ns[-1] / 1e6 if self._ns else 0.0

    def figures(self) -> dict[str, Any]:
        """Return ``periods``, ``latency_ms`` (its ``p50``, ``p99`` and ``max``), and a histogram, ready for JSON.

        A bin of the histogram is ``[upper edge in ms, periods]``; there are ten bins to a decade, and empty ones are
        left out.
        """
        if not self._ns:
            return {"periods": 0, "latency_ms": {}, "histogram_ms": []}
        milliseconds = np.asarray(self._ns) / 1e6
        found = dict(zip(("p50", "p99", "max"), np.percentile(milliseconds, [50, 99, 100]).tolist(), strict=True))
        numbers = np.ceil(BINS_PER_DECADE * np.log10(np.maximum(milliseconds, 1e-6))).astype(int)
        edges, counts = np.unique(numbers, return_counts=True)
        histogram = [
            [10 ** (edge / BINS_PER_DECADE), count] for edge, count in zip(edges.tolist(), counts.tolist(), strict=True)
        ]
        return {"periods": len(milliseconds), "latency_ms": found, "histogram_ms": histogram}
