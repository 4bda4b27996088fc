"""Keeping pace with the wall clock: absolute deadlines, what became of them, and what to do if one is missed."""

import time
from collections.abc import Callable
from typing import Literal

from neurorobo.errors import NeuroroboError

Overrun = Literal["stop", "hold", "skip"]
"""What to do in a period that took too long.

``stop`` raises. ``hold`` lets the last command hold and the next period begin at once; later ones are to be in time
again, on the grid that they had. ``skip`` leaves out the periods that were missed and goes on on the grid.
"""


class MissedDeadlineError(NeuroroboError):
    """A period took longer than it may."""


class Pacer:
    """Lets periods begin on a grid of the monotonic clock, and counts those that took too long.

    A real body calls :meth:`start` when it starts, and :meth:`wait` to let a period pass. Deadlines are absolute, so
    that no delay adds up. For one thread.
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
        self.periods = self.skipped = 0
        self.late: list[tuple[int, int]] = []
        """Of periods that took too long, when they were to end, by the clock, and by how much they ended later (ns)."""
        self.start()

    @property
    def overruns(self) -> int:
        """How many periods took too long."""
        return len(self.late)

    def start(self) -> None:
        """Begin the grid now; the counts go on."""
        self._deadline_ns = self._clock()

    def deadline_ns(self, duration_ns: int) -> int:
        """Return when a period of this length that is under way has to end, by the clock."""
        return self._deadline_ns + duration_ns

    def wait(self, duration_ns: int) -> None:
        """Let a period of this length end; a MissedDeadlineError if it is over already and the body is to stop then."""
        self._deadline_ns += duration_ns
        self.periods += 1
        late_ns = self._clock() - self._deadline_ns
        if late_ns > 0:
            self.late.append((self._deadline_ns, late_ns))
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
