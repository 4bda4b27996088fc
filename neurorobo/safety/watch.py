"""The supervisor of a body that moves by itself: it watches all the time, stops at once, and sees that it stands."""

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

from neurorobo.errors import NeuroroboError
from neurorobo.safety.guard import Trip
from neurorobo.safety.machine import SafetyMachine

Check = Callable[[int], Trip | None]
"""What is asked again and again, with the present time in ns of the monotonic clock, whether something is wrong."""


class Mover(Protocol):
    """Something that moves and can be stopped, such as a controller with its axes."""

    def stop(self) -> None:
        """Stop as fast as it can; called from any thread, and waits for no other transaction."""

    def is_moving(self) -> bool:
        """Ask whether anything moves."""


class SafetyWatch:
    """Stops all movers at the first trip, each in a thread of its own, and asks them until they stand.

    Checks are asked every ``period_s``; a sensor's own thread may call :meth:`trip` at any time, which returns at once.
    A mover that does not stand within ``stands_s``, or does not answer, is latched: its power has to be cut by hand.
    """

    def __init__(
        self,
        machine: SafetyMachine,
        movers: Mapping[str, Mover],
        checks: Sequence[Check] = (),
        *,
        period_s: float = 0.005,
        stands_s: float = 1.0,
    ) -> None:
        """Watch over ``movers`` by their names; :meth:`start` begins."""
        self.machine, self.movers, self.checks = machine, dict(movers), tuple(checks)
        self.period_s, self.stands_s = period_s, stands_s
        self.reaction_ms: float | None = None
        """From the first trip until all stops were sent."""
        self._ends, self._stop, self._stands = threading.Event(), threading.Event(), threading.Event()
        self._tripped_ns, self._left = 0, 0
        self._lock = threading.Lock()
        self._threads: list[threading.Thread] = []

    def start(self) -> None:
        """Begin to watch."""
        self._ends.clear()
        self._stop.clear()
        self._stands.clear()
        self._left = len(self.movers)
        self._threads = [
            threading.Thread(target=self._watch, name="safety watch", daemon=True),
            *(
                threading.Thread(target=self._stand, args=(name, mover), name=f"stop {name}", daemon=True)
                for name, mover in self.movers.items()
            ),
        ]
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """End; safe to call twice. What is being stopped is stopped first."""
        if self._stop.is_set():
            self._stands.wait(2 * self.stands_s + 1)
        self._ends.set()
        self._stop.set()
        for thread in self._threads:
            thread.join(2 * self.stands_s + 1)
        self._threads = []

    def trip(self, trip: Trip) -> None:
        """Stop all movers; returns at once."""
        if self.machine.stop(trip):
            self._tripped_ns = time.monotonic_ns()
            self._stop.set()

    def wait_until_all_stand(self) -> bool:
        """Wait until all movers stand after a trip, or it is known that they do not; return whether it came to it."""
        return self._stands.wait(2 * self.stands_s + 1)

    def sleep(self, seconds: float) -> None:
        """Sleep, but no longer than until the first trip."""
        self._stop.wait(seconds)

    def _watch(self) -> None:
        while not self._ends.wait(self.period_s) and not self._stop.is_set():
            for check in self.checks:
                try:
                    trip = check(time.monotonic_ns())
                except Exception as error:  # a guard that fails guards nothing
                    trip = Trip("safety watch", f"a check failed: {error}", "see to it before the next run", "stop")
                if trip is not None:
                    self.trip(trip)
                    return

    def _stand(self, name: str, mover: Mover) -> None:
        """Wait for a trip, stop one mover, and see that it stands."""
        self._stop.wait()
        if self._ends.is_set():
            return
        deadline, fault = time.monotonic() + self.stands_s, "it does not stand still"
        stands = False
        first = True
        while not stands and (first or time.monotonic() < deadline):
            try:
                mover.stop()
                self._sent(first)
                stands = not mover.is_moving()
            except NeuroroboError as error:
                fault = str(error)
                self._ends.wait(0.01)
            first = False
        if not stands:
            cure = "cut its power now, then look at the rig before you reset it"
            self.machine.stop(Trip(name, f"after a stop, {fault}", cure, "latch"))
        with self._lock:
            self._left -= 1
            if self._left == 0:
                self._stands.set()

    def _sent(self, first: bool) -> None:
        with self._lock:
            if first:
                self.reaction_ms = (time.monotonic_ns() - self._tripped_ns) / 1e6
