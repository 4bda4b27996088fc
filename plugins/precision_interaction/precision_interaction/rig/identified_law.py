"""The law of an identified contact as a teacher."""

from collections.abc import Mapping

from torch import Tensor

from neurorobo.regions.region import Probe, Region, State
from precision_interaction.rig.identified_law_config import IdentifiedLawConfig
from precision_interaction.rig.insertion_rig_config import MeasuredContactConfig


class IdentifiedLaw(Region):
    """Expects one period more than what is fed back, so n uses give n times the law (Eq. 35).

    An intercept, which comes once per started axial move, is spread over the radial periods of that move.
    """

    config: IdentifiedLawConfig

    def step(
        self, inputs: Mapping[str, Tensor], state: State, probe: Probe | None = None
    ) -> tuple[dict[str, Tensor], State]:
        """Look one period further ahead: speed (batch, 1), feedbacks and outputs (batch, 2)."""
        contact = self.config.contact
        period_s = self.config.period_s(self.clock)
        distance_um = inputs["speed"].clamp(min=0.0) * period_s
        mean_mN = distance_um * distance_um.new_tensor(contact.mean_slope[:2])
        variance_mN2 = distance_um * distance_um.new_tensor(contact.variance_slope[:2])
        if isinstance(contact, MeasuredContactConfig):
            share = (distance_um > 0).to(distance_um) * (period_s / self.clock.seconds(self.config.axial_period))
            mean_mN = mean_mN + share * share.new_tensor(contact.mean_intercept[:2])
            variance_mN2 = variance_mN2 + share * share.new_tensor(contact.variance_intercept[:2])
        return {
            "mean": inputs["mean_feedback"] + mean_mN,
            "variance": inputs["variance_feedback"] + variance_mN2,
        }, state
