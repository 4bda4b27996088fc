"""The task of a Gymnasium environment: what it rewards, and when it ends."""

from collections.abc import Sequence

import numpy as np

from neurorobo.bodies import Array
from neurorobo.bodies.gymnasium_body import GymnasiumBody
from neurorobo.errors import NeuroroboError
from neurorobo.tasks.gymnasium_task_config import GymnasiumTaskConfig
from neurorobo.tasks.task import Flags, Task


class GymnasiumTask(Task[GymnasiumBody]):
    """Reward and end are the environment's; the figures are the ``return``, the sum of all rewards, and the ``steps``.

    Raises a NeuroroboError for any other body.
    """

    higher_is_better = frozenset({"return"})

    def __init__(self, config: GymnasiumTaskConfig, body: GymnasiumBody) -> None:
        if not isinstance(body, GymnasiumBody):
            raise NeuroroboError("rewards what a `gymnasium_environment` does; take that as the body")
        super().__init__(config, body)
        self.reset(0)

    def reset(self, batch: int, which: Flags | None = None) -> None:
        """Begin to add up."""
        if which is None:
            self._return, self._steps = np.zeros(batch), np.zeros(batch)
        else:
            self._return[which] = self._steps[which] = 0.0

    def observe(self, duration_ns: int, running: Flags) -> None:
        """Add up what the running episodes gained."""
        self._return[running] += self.body.reward[running]
        self._steps[running] += 1

    def reward(self) -> Array:
        """Return the environment's reward."""
        return self.body.reward

    def terminated(self) -> Flags:
        """Return what the environment said."""
        return self.body.terminated

    def truncated(self) -> Flags:
        """Return what the environment said."""
        return self.body.truncated

    def metrics(self) -> Sequence[dict[str, float]]:
        """Return the return and the steps."""
        pairs = zip(self._return.tolist(), self._steps.tolist(), strict=True)
        return [{"return": gained, "steps": steps} for gained, steps in pairs]
