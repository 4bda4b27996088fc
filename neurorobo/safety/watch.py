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
        self.tripped_ns: int | None = None
        """When the first trip came, by the monotonic clock."""
        self.sent_ms: dict[str, float] = {}
        self.stood_ms: dict[str, float] = {}
        """From the first trip until each mover was sent its stop, and until it was seen to stand."""
        self._ends, self._stop, self._stands = threading.Event(), threading.Event(), threading.Event()
        self._left = 0
        self.faults: dict[str, str] = {}
        """Movers that are not known to stand after a stop, and why."""
        self._lock = threading.Lock()
        self._threads: list[threading.Thread] = []

    @property
    def reaction_ms(self) -> float | None:
        """From the first trip until all stops were sent, if they were."""
        return max(self.sent_ms.values()) if self.sent_ms.keys() == self.movers.keys() else None

    def start(self) -> None:
        """Begin to watch."""
        self.tripped_ns, self.sent_ms, self.stood_ms = None, {}, {}
        self._ends.clear()
        self._stop.clear()
        self._stands.clear()
        self._threads = [threading.Thread(target=self._watch, name="safety watch", daemon=True)]
        self._threads[0].start()
        self._await_stop()

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
        """Stop all movers at the first trip; returns at once, or when the latch is written, if there is to be one."""
        self.machine.stop(trip, self._begin_stop)

    def stop_again(self) -> bool:
        """Stop all movers once more after a trip, as they have been moved since; return whether all stand."""
        self._stands.clear()
        self._await_stop()
        return self.wait_until_all_stand() and not self.faults

    def _begin_stop(self) -> None:
        self.tripped_ns = time.monotonic_ns()
        self._stop.set()

    def _await_stop(self) -> None:
        """Let a thread for each mover wait for the stop."""
        self._left, self.faults = len(self.movers), {}
        threads = [
            threading.Thread(target=self._stand, args=(name, mover), name=f"stop {name}", daemon=True)
            for name, mover in self.movers.items()
        ]
        self._threads += threads
        for thread in threads:
            thread.start()

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
        if self.tripped_ns is None:
            return
        deadline, fault = time.monotonic() + self.stands_s, "it does not stand still"
        stands, tried = False, 0
        while not stands and (not tried or time.monotonic() < deadline):
            tried += 1
            try:
                mover.stop()
                self._note(self.sent_ms, name)
                stands = not mover.is_moving()
            except Exception as error:  # whatever fails, the others have to be waited for
                fault = str(error).removeprefix(f"{name}: ") if isinstance(error, NeuroroboError) else repr(error)
                time.sleep(0.01)
        if stands:
            self._note(self.stood_ms, name)
        else:
            self.faults[name] = fault
            cure = "cut its power now, then look at the rig before you reset it"
            self.machine.stop(Trip(name, f"after a stop, {fault}", cure, "latch"))
        with self._lock:
            self._left -= 1
            if self._left == 0:
                self._stands.set()

    def _note(self, times_ms: dict[str, float], name: str) -> None:
        assert self.tripped_ns is not None
        times_ms.setdefault(name, (time.monotonic_ns() - self.tripped_ns) / 1e6)
