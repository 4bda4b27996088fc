"""The layer between brain and body: no command leaves its limits, and no body goes on beyond those of its sensors."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from neurorobo.bodies.body import Array, Body
from neurorobo.errors import NeuroroboError
from neurorobo.safety.guard import Reading, Trip


class Supervisor:
    """Clamps commands to what the body allows at this moment and counts each intervention.

    A ``hold`` command is given again at every call, clamped anew, until another takes its place; an ``increment`` is
    given once. An intervention is a new command that is changed, or a held one that has to be changed further than
    before. ``counts`` holds, by actuator, those of each body (batch) since :meth:`reset`; ``latest`` those of the last
    :meth:`advance`, 0 or 1. A command that is not a number stops the body and raises: there is nothing sensible to
    clamp it to.

    After every motion the guards of the body see what its sensors report; ``trips`` holds what they found, by the
    number of the body, the first of each. A real body is watched by guards of its own as well, all the time.
    """

    trips: dict[int, Trip]
    counts: dict[str, NDArray[np.int64]]
    latest: dict[str, NDArray[np.int64]]

    def __init__(self, body: Body) -> None:
        """Watch over ``body``; call :meth:`reset` before the first command."""
        self.body = body
        self.reset(0)

    def reset(self, batch: int, which: NDArray[np.bool_] | None = None) -> None:
        """Forget the interventions, for ``batch`` bodies or those of them that ``which`` marks, and what is held.

        What is held is forgotten for all: a body that starts again is not to be given its old command.
        """
        self._batch = batch
        if which is None:
            self.trips = {}
            self._guards = [self.body.guards() for _ in range(batch)]
            self._elapsed_ns = [0] * batch
        else:
            for i in np.flatnonzero(which).tolist():
                self.trips.pop(i, None)
                self._guards[i] = self.body.guards()
                self._elapsed_ns[i] = 0
        none = np.zeros(batch, dtype=np.int64)
        if which is None:
            self.counts = {name: none.copy() for name in self.body.actuators}
        else:
            for count in self.counts.values():
                count[which] = 0
        self.latest = dict.fromkeys(self.body.actuators, none)
        self._held: dict[str, Array] = {}
        self._changes: dict[str, Array] = {}

    @property
    def interventions(self) -> NDArray[np.int64]:
        """All interventions of each body (batch) since :meth:`reset`, of all actuators."""
        return sum(self.counts.values(), np.zeros(self._batch, dtype=np.int64))

    def advance(self, commands: Mapping[str, Array], duration_ns: int, running: NDArray[np.bool_]) -> dict[str, Array]:
        """Clamp ``commands`` and those held, let the body carry them out, and return what it was given.

        Interventions count only where ``running`` (batch).
        """
        for name, wanted in commands.items():
            broken = wanted[running][~np.isfinite(wanted[running])]
            if broken.size:
                self.body.stop()
                raise NeuroroboError(
                    f"the command `{name}` is {broken[0]}: the body was stopped; "
                    "look at the inputs of the step that computes it"
                )
        limits = self.body.limits(duration_ns)
        allowed = {}
        self.latest = {name: np.zeros_like(count) for name, count in self.counts.items()}
        for name, wanted in {**self._held, **commands}.items():
            allowed[name] = np.clip(wanted, *limits[name])
            change = np.abs(allowed[name] - wanted)
            before = 0.0 if name in commands else self._changes[name]
            slack = 1e-6 * np.maximum(1.0, np.abs(wanted))
            self.latest[name] = ((change > before + slack).any(axis=1) & running).astype(np.int64)
            self.counts[name] = self.counts[name] + self.latest[name]
            if self.body.actuators[name].kind == "hold":
                self._held[name], self._changes[name] = wanted.copy(), change
        self.body.advance(allowed, duration_ns)
        if any(self._guards):
            self._look(duration_ns, running)
        return allowed

    @property
    def tripped(self) -> NDArray[np.bool_]:
        """Which bodies (batch) a guard has stopped."""
        return np.isin(np.arange(self._batch), list(self.trips))

    def _look(self, duration_ns: int, running: NDArray[np.bool_]) -> None:
        """Let the guards of running bodies see what the sensors report now."""
        observation = self.body.read()
        for i in np.flatnonzero(running & ~self.tripped).tolist():
            self._elapsed_ns[i] += duration_ns
            for guard in self._guards[i]:
                trip = guard.check(Reading(self._elapsed_ns[i], tuple(observation[guard.name][i].tolist())))
                if trip is not None:
                    self.trips.setdefault(i, trip)
