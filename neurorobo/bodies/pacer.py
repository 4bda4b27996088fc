"""Keeping pace with the wall clock: absolute deadlines, what became of them, and what to do if one is missed."""

import time
from array import array
from collections.abc import Callable, Mapping
from typing import Literal

import numpy as np

from neurorobo.errors import NeuroroboError

Overrun = Literal["stop", "hold", "skip"]
"""What to do in a period that took too long.

``stop`` raises. ``hold`` lets the last command hold and the next period begin at once; later ones are to be in time
again, on the grid that they had. ``skip`` leaves out the periods that were missed and goes on on the grid.
"""


class MissedDeadlineError(NeuroroboError):
    """A period took longer than it may."""


class Pacer:
    """Lets periods begin on a grid of the monotonic clock, and keeps how long each took to answer.

    A real body calls :meth:`start` when it starts, :meth:`sensed` when it is read, :meth:`commanded` when its commands
    are out, and :meth:`wait` to let the period pass. Deadlines are absolute, so that no delay adds up. For one thread.
    """

    def __init__(
        self,
        overrun: Overrun,
        *,
        clock: Callable[[], int] = time.monotonic_ns,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """Say what to do with a period that takes too long; ``clock`` counts nanoseconds, ``sleep`` takes seconds."""
        self.overrun, self._clock, self._sleep = overrun, clock, sleep
        self.start()

    def start(self) -> None:
        """Begin the grid now, and forget what was."""
        self._deadline_ns = self._sensed_ns = self._clock()
        self._latencies_ns = array("q")
        self.periods = self.overruns = self.skipped = 0

    def sensed(self) -> None:
        """Note when the sensors were read: the latency counts from here."""
        self._sensed_ns = self._clock()

    def commanded(self) -> None:
        """Note that the commands are out."""
        self._latencies_ns.append(self._clock() - self._sensed_ns)

    def wait(self, duration_ns: int) -> None:
        """Let a period of this length end; a MissedDeadlineError if it is over already and the body is to stop then."""
        self._deadline_ns += duration_ns
        self.periods += 1
        late_ns = self._clock() - self._deadline_ns
        if late_ns > 0:
            self.overruns += 1
            if self.overrun == "stop":
                raise MissedDeadlineError(
                    f"period {self.periods} of {duration_ns / 1e6:g} ms ended {late_ns / 1e6:.1f} ms late: the body "
                    "was stopped; choose a longer period or a smaller brain, leave the machine to this alone, or say "
                    "`overrun: hold` or `skip`"
                )
            if self.overrun == "skip":
                missed = late_ns // duration_ns + (late_ns % duration_ns > 0)
                self.skipped += missed
                self._deadline_ns += missed * duration_ns
        while (left_ns := self._deadline_ns - self._clock()) > 0:
            self._sleep(left_ns * 1e-9)

    @property
    def latencies_ms(self) -> Mapping[str, float]:
        """How long it took from the sensors to the commands: `p50`, `p99` and `max`, or nothing of no period."""
        if not self._latencies_ns:
            return {}
        found = np.percentile(np.asarray(self._latencies_ns), [50, 99, 100]) / 1e6
        return dict(zip(("p50", "p99", "max"), map(float, found), strict=True))

    def histogram(self, bins_per_decade: int = 10) -> list[tuple[float, int]]:
        """Return the upper edge in ms and the number of latencies of each bin that has some, on a logarithmic scale."""
        milliseconds = np.asarray(self._latencies_ns) / 1e6
        numbers = np.ceil(bins_per_decade * np.log10(np.maximum(milliseconds, 1e-6))).astype(int)
        edges, counts = np.unique(numbers, return_counts=True)
        return [(float(10 ** (edge / bins_per_decade)), int(count)) for edge, count in zip(edges, counts, strict=True)]
