"""The comparison of the contact felt with the one expected."""

from collections.abc import Mapping

import torch
from torch import Tensor

from neurorobo.regions.region import Probe, Region, State
from precision_interaction.regions.comparator_config import ComparatorConfig


class Comparator(Region):
    """Tells the contact of the period before: the change of the force, and what the stage took off it (Eq. 2).

    State: `force` and `stage` (batch, 2) at the period's start, `begun` (batch, 1), 1 from the second period on.
    """

    config: ComparatorConfig

    def init_state(self, batch: int) -> State:
        """Return the state before anything is felt."""
        return {"force": torch.zeros(batch, 2), "stage": torch.zeros(batch, 2), "begun": torch.zeros(batch, 1)}

    def step(
        self, inputs: Mapping[str, Tensor], state: State, probe: Probe | None = None
    ) -> tuple[dict[str, Tensor], State]:
        """Compare."""
        force_mN, stage_um, begun = inputs["force"], inputs["stage"], state["begun"]
        taken_off_mN = self.config.stiffness * (stage_um - state["stage"])
        contact_mN = begun * (force_mN - state["force"] + taken_off_mN)
        mean_error_mN = begun * (contact_mN - inputs["mean"])
        rounding_mN2 = 2 * self.config.force_resolution**2 / 12  # of two readings
        variance_error_mN2 = begun * (mean_error_mN**2 - rounding_mN2 - inputs["variance"])
        outputs = {"contact": contact_mN, "mean_error": mean_error_mN, "variance_error": variance_error_mN2}
        return outputs, {"force": force_mN, "stage": stage_um, "begun": torch.ones_like(begun)}
