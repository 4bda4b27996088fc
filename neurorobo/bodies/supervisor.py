"""The command layer between brain and body: no command leaves its limits."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from neurorobo.bodies.body import Array, Body
from neurorobo.errors import NeuroroboError


class Supervisor:
    """Clamps commands to what the body allows at this moment and counts each intervention.

    A ``hold`` command is given again at every call, clamped anew, until another takes its place; an ``increment`` is
    given once. An intervention is a new command that is changed, or a held one that has to be changed further than
    before. ``counts`` holds, by actuator, those of each body (batch) since :meth:`reset`; ``latest`` those of the last
    :meth:`advance`, 0 or 1. A command that is not a number stops the body and raises: there is nothing sensible to
    clamp it to.
    """

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
        return allowed
