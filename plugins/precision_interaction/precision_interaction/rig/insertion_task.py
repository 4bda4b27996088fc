"""The insertion task: reward, end, and the figures of an episode."""

from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from neurorobo.bodies import Array, Body
from neurorobo.errors import NeuroroboError
from neurorobo.tasks.task import Flags, Task
from precision_interaction.rig.insertion_body import InsertionBody
from precision_interaction.rig.insertion_task_config import InsertionTaskConfig


class InsertionTask(Task[InsertionBody]):
    """Insert the peg to the body's length: the reward of Eq. 13, and the figures of Sec. VI-B.

    The force is the Euclidean norm of the true radial force at the end of every motion (radial period). An episode
    ends with the axial move after which at most `tolerance` is left, or when the length is exceeded, and fails at
    the time limit.
    """

    scene: ClassVar[str | None] = "precision_interaction.rig.scene:InsertionScene"

    def __init__(self, config: InsertionTaskConfig, body: Body) -> None:
        if not isinstance(body, InsertionBody):
            raise NeuroroboError(
                "task: `precision.insertion` needs an insertion body, such as `precision.insertion_rig`, "
                f"not a {type(body).__name__}"
            )
        super().__init__(config, body)
        self.config = config
        self.reset(0)

    def reset(self, batch: int, which: Flags | None = None) -> None:
        """Begin `batch` episodes, or begin again those that `which` marks."""
        if which is None:
            which = np.ones(batch, dtype=np.bool_)
            self._elapsed_ns: NDArray[np.int64] = np.zeros(batch, dtype=np.int64)
            self._motions: NDArray[np.int64] = np.zeros(batch, dtype=np.int64)
            self._force_sum_mN: Array = np.zeros(batch)
            self._force_max_mN: Array = np.zeros(batch)
            self._travel_max_um: Array = np.zeros(batch)
            self._left_um: Array = np.zeros(batch)
            self._terminated: Flags = np.zeros(batch, dtype=np.bool_)
        self._elapsed_ns[which] = 0
        self._motions[which] = 0
        self._terminated[which] = False
        for values in (self._force_sum_mN, self._force_max_mN, self._travel_max_um):
            values[which] = 0.0
        self._left_um[which] = self.body.config.length

    def observe(self, duration_ns: int, running: Flags) -> None:
        """Take note of a motion of the episodes that are `running`; the others keep their figures."""
        force_mN = np.linalg.norm(self.body.force_mN[:, :2], axis=1)
        self._elapsed_ns += duration_ns * running
        self._motions += running
        self._force_sum_mN += np.where(running, force_mN, 0.0)
        self._force_max_mN = np.where(running, np.maximum(self._force_max_mN, force_mN), self._force_max_mN)
        travel_um = np.where(running, self.body.travel_um, 0.0)
        self._travel_max_um = np.maximum(self._travel_max_um, travel_um)
        self._left_um = np.where(running, self.body.config.length - self.body.travel_um, self._left_um)
        complete = (self._left_um <= self.config.tolerance) & self.body.between_moves
        self._terminated = np.where(running, complete | (self._left_um < 0), self._terminated)

    def reward(self) -> Array:
        """Return -(d^2 - epsilon) - gamma_f f'f, with the distance d left and the force f in their configured units.

        Eq. 13 as printed reads (-1)^f (d^2 - epsilon) with time in place of length; maximising it would not
        minimise Eq. 3. epsilon is the tolerance squared.
        """
        config = self.config
        distance = self._left_um / config.distance_unit
        closeness = config.tolerance / config.distance_unit
        force = self.body.force_mN[:, :2] / config.force_unit
        return np.asarray(closeness**2 - distance**2 - config.force_weight * (force**2).sum(axis=1))

    def terminated(self) -> Flags:
        """Return which insertions are complete, or have gone too far."""
        return self._terminated.copy()

    def truncated(self) -> Flags:
        """Return which insertions have reached the time limit."""
        return np.asarray((self._elapsed_ns >= self.config.time_limit) & ~self._terminated)

    def metrics(self) -> Sequence[dict[str, float]]:
        """Return steps (axial moves), duration, mean and largest force, final error, overshoot and success of each."""
        error_um = np.abs(self._left_um)
        overshoot_um = np.maximum(self._travel_max_um - self.body.config.length, 0.0)
        columns = {
            "steps": np.ceil(self._elapsed_ns / self.body.config.axial_period),
            "duration_s": self._elapsed_ns / 1e9,
            "mean_force_mN": self._force_sum_mN / np.maximum(self._motions, 1),
            "max_force_mN": self._force_max_mN,
            "final_error_um": error_um,
            "overshoot_um": overshoot_um,
            "success": (error_um <= self.config.tolerance) & (overshoot_um == 0),
        }
        return [{name: float(values[i]) for name, values in columns.items()} for i in range(len(error_um))]
