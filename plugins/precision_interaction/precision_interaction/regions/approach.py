"""The knowledge of the gap: no contact is expected before it is closed."""

from collections.abc import Mapping

import torch
from torch import Tensor

from neurorobo.regions.region import Probe, Region, State
from precision_interaction.regions.approach_config import ApproachConfig


def approach(speed_um_s: Tensor, remaining_um: Tensor, *, length_um: float, gap_um: float, period_s: float) -> Tensor:
    """The speed (batch, 1) at which contact is to be expected: 0 while the coming period ends inside the gap."""
    travel_after_um = length_um - remaining_um + speed_um_s * period_s
    return torch.where(travel_after_um > gap_um, speed_um_s, torch.zeros_like(speed_um_s))


class Approach(Region):
    """The region that computes `approach`."""

    config: ApproachConfig

    def step(
        self, inputs: Mapping[str, Tensor], state: State, probe: Probe | None = None
    ) -> tuple[dict[str, Tensor], State]:
        """Pass the speed on, or 0 inside the gap."""
        speed_um_s = approach(
            inputs["speed"],
            inputs["remaining"],
            length_um=self.config.length,
            gap_um=self.config.gap,
            period_s=self.clock.seconds(self.config.period),
        )
        return {"speed": speed_um_s}, state
