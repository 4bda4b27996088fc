"""The states of whatever moves, and the latch that outlives a process."""

import json
import threading
from collections.abc import Callable
from dataclasses import asdict
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path

from neurorobo.errors import NeuroroboError
from neurorobo.files import write_whole
from neurorobo.safety.guard import Trip


class SafetyError(NeuroroboError):
    """A body was stopped, or may not move; ``trip`` says why, if a guard has stopped it."""

    def __init__(self, message: str, trip: Trip | None = None) -> None:
        self.trip = trip
        super().__init__(message)


class SafetyState(StrEnum):
    """What a body may do.

    Only an ``armed`` body can start to run, only a ``running`` one may move. A ``stopped`` one has to be disarmed and
    armed again; a ``latched`` one has to be reset by hand before that.
    """

    DISARMED = "disarmed"
    ARMED = "armed"
    RUNNING = "running"
    STOPPED = "stopped"
    LATCHED = "latched"


class Latch:
    """A file that says why a body must not move before somebody has looked at it; without the file, it may."""

    def __init__(self, path: Path, reset: str | None = None) -> None:
        """Keep the latch at ``path``; ``reset`` is what to type to remove it, if there is such a command."""
        self.path = path
        self._cure = f"remove {path}" if reset is None else f"`{reset}`"

    def set(self, trip: Trip) -> None:
        """Write down why; the first reason stays. A NeuroroboError if it cannot be written."""
        if not self.path.exists():
            told = {**asdict(trip), "since": datetime.now(UTC).isoformat(timespec="seconds")}
            write_whole(self.path, (json.dumps(told, indent=2) + "\n").encode())

    def reason(self) -> str | None:
        """Return why it is set, or None; a file that cannot be read is a reason."""
        try:
            told = json.loads(self.path.read_text(encoding="utf-8"))
            return f"{told['place']}: {told['fault']}, {told['since']}"
        except FileNotFoundError:
            return None
        except (OSError, ValueError, KeyError, TypeError) as error:
            return f"{self.path} cannot be read ({error})"

    def refusal(self) -> str | None:
        """Return why it is set, and what to do about that, or None."""
        reason = self.reason()
        return None if reason is None else self.refusal_of(reason)

    def refusal_of(self, reason: str) -> str:
        """Return what to tell of a reason that is about to be written, or was."""
        return f"it is latched: {reason}; look at it, see that it is free to move, then {self._cure}"

    def clear(self) -> None:
        """Allow motion again: for a person who has looked at the body, never for a program."""
        self.path.unlink(missing_ok=True)


class SafetyMachine:
    """The state of one body; all methods may be called from any thread.

    The first trip decides what is reported; a later one can only make it worse, from stopped to latched.
    """

    def __init__(self, latch: Latch) -> None:
        """Begin disarmed, or latched if ``latch`` is set from before."""
        self.latch = latch
        self._lock = threading.Lock()
        self._trip: Trip | None = None
        self.latch_fault: str | None = None
        """Why the latch could not be written, if it had to be: then it holds for this process alone."""
        self._state = SafetyState.DISARMED if latch.reason() is None else SafetyState.LATCHED

    @property
    def state(self) -> SafetyState:
        """The present state."""
        return self._state

    @property
    def trip(self) -> Trip | None:
        """Why it was stopped, if it was."""
        return self._trip

    def arm(self) -> None:
        """Allow a disarmed body to run; a SafetyError for one that is latched, stopped or armed already."""
        if (refusal := self.latch.refusal()) is not None:
            self._state = SafetyState.LATCHED
            raise SafetyError(refusal)
        self._change(SafetyState.ARMED, SafetyState.DISARMED)

    def run(self) -> None:
        """Let an armed body run; a SafetyError for any other."""
        self._change(SafetyState.RUNNING, SafetyState.ARMED)

    def rest(self) -> None:
        """Let a running body rest; one that was stopped stays so."""
        with self._lock:
            if self._state is SafetyState.RUNNING:
                self._state = SafetyState.ARMED

    def disarm(self) -> None:
        """Take the leave to move; a latched body stays latched."""
        with self._lock:
            if self._state is not SafetyState.LATCHED:
                self._state, self._trip = SafetyState.DISARMED, None

    def stop(self, trip: Trip, at_once: Callable[[], None] = lambda: None) -> bool:
        """Stop for a reason, and return whether it is the first; only a trip to be latched changes what is stopped.

        ``at_once`` is called if it is the first, before the latch is written: that takes its time, and may fail.
        """
        with self._lock:
            first = self._state not in (SafetyState.STOPPED, SafetyState.LATCHED)
            if first:
                self._state, self._trip = SafetyState.STOPPED, trip
            if trip.reaction == "latch":
                self._state = SafetyState.LATCHED
        if first:
            at_once()
        if trip.reaction == "latch":
            try:
                self.latch.set(trip)
            except (NeuroroboError, OSError) as error:
                self.latch_fault = str(error)
        return first

    def check(self) -> None:
        """Raise a SafetyError unless the body may move."""
        if self._state is not SafetyState.RUNNING:
            raise SafetyError(str(self._trip) if self._trip else self._refusal(), self._trip)

    def _change(self, new: SafetyState, needed: SafetyState) -> None:
        with self._lock:
            if self._state is not needed:
                raise SafetyError(str(self._trip) if self._trip else self._refusal(), self._trip)
            self._state = new

    def _refusal(self) -> str:
        return (
            f"it is {self._state} and may not move; say `--arm` to let it, or `--dry-run` to see what it would be sent"
        )
