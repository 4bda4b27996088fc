"""The command layer between brain and body: no command leaves its limits."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from neurorobo.bodies.body import Array, Body
from neurorobo.errors import NeuroroboError


class Supervisor:
    """Clamps commands to what the body allows at this moment and counts each intervention.

    ``interventions`` (batch) counts the commands changed since :meth:`reset`, actuator by actuator and period by
    period. A command that is not a number stops the body and raises: there is nothing sensible to clamp it to.
    """

    def __init__(self, body: Body) -> None:
        """Watch over ``body``; call :meth:`reset` before the first command."""
        self.body = body
        self.reset(0)

    def reset(self, batch: int) -> None:
        """Forget the interventions, for ``batch`` bodies."""
        self.interventions: NDArray[np.int64] = np.zeros(batch, dtype=np.int64)

    def advance(self, commands: Mapping[str, Array], duration_ns: int, running: NDArray[np.bool_]) -> dict[str, Array]:
        """Clamp ``commands``, let the body carry them out for ``duration_ns``, and return what it was given.

        Interventions count only where ``running`` (batch).
        """
        limits = self.body.limits(duration_ns)
        allowed = {}
        for name, wanted in commands.items():
            if not np.isfinite(wanted[running]).all():
                self.body.stop()
                raise NeuroroboError(
                    f"the command `{name}` is not a number: the body was stopped; "
                    "look at the inputs of the step that computes it"
                )
            lo, hi = limits[name]
            allowed[name] = np.clip(wanted, lo, hi)
            slack = 1e-6 * np.maximum(1.0, np.abs(wanted))
            changed = (np.abs(allowed[name] - wanted) > slack).any(axis=1)
            self.interventions += changed & running
        self.body.advance(allowed, duration_ns)
        return allowed
