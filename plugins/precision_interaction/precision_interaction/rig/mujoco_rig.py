"""The insertion body whose contact MuJoCo solves."""

from collections.abc import Sequence
from importlib.util import find_spec
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from neurorobo.bodies.body import Array
from neurorobo.errors import NeuroroboError
from neurorobo.units import format_duration
from precision_interaction.rig.insertion_body import InsertionBody
from precision_interaction.rig.mujoco_rig_config import MujocoRigConfig

if TYPE_CHECKING:
    from precision_interaction.rig.mujoco_model import PegAndHole


class MujocoRig(InsertionBody):
    """Each body is a MuJoCo simulation of its own; its seed draws where the rings of its hole lie.

    A NeuroroboError if MuJoCo is not installed. ``rigs`` are the simulations.
    """

    config: MujocoRigConfig
    rigs: "list[PegAndHole]"

    def __init__(self, config: MujocoRigConfig) -> None:
        super().__init__(config)
        if find_spec("mujoco") is None:
            raise NeuroroboError(
                "`precision.mujoco_rig` needs MuJoCo; pip install 'neurorobo-precision-interaction[mujoco]'"
            )
        from precision_interaction.rig.mujoco_model import build

        self._model = build(config)
        self.reset([])

    def reset(self, seeds: Sequence[int], which: NDArray[np.bool_] | None = None) -> None:
        """Bring all bodies, or those that `which` marks, to the start: `gap` apart, nothing moving, no force."""
        from precision_interaction.rig.mujoco_model import PegAndHole

        super().reset(seeds, which)
        fresh = [PegAndHole(self.config, self._model, seed) for seed in seeds]
        if which is None:
            self.rigs = fresh
        else:
            for i, rig in zip(np.flatnonzero(which), fresh, strict=True):
                self.rigs[i] = rig

    def _force_after_mN(self, travel_um: Array, stage_um: Array, duration_ns: int) -> Array:
        if duration_ns % self.config.time_step:
            raise NeuroroboError(
                f"body: a motion of {format_duration(duration_ns)} is no multiple of `body.time_step`, "
                f"{format_duration(self.config.time_step)}; shorten the step"
            )
        moved = [rig.move(travel_um[i], stage_um[i], duration_ns) for i, rig in enumerate(self.rigs)]
        return np.array(moved).reshape(-1, 3)
