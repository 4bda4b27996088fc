"""The contact expectation of Eq. 1, 8 and 35 as a teacher for the hippocampus."""

from collections.abc import Mapping
from typing import Literal, NamedTuple

import torch
from torch import Tensor

from neurorobo.regions.region import Probe, Region, State
from precision_interaction import table_one
from precision_interaction.teachers.contact_expectation_config import ContactLawConfig

LawName = Literal["proportional", "measured"]


class Expectation(NamedTuple):
    """What the coming periods add to the radial force, (batch, 2) each."""

    mean_mN: Tensor
    variance_mN2: Tensor


def one_period(
    speed_um_s: Tensor, *, period_s: float, axial_period_s: float = 1.0, law: LawName = "proportional"
) -> Expectation:
    """Mean and variance of the force increment of one radial period (Eq. 1), for speeds (batch, 1).

    `proportional` is the law of Eq. 8 and 35. `measured` has an intercept per started axial move, spread here over the
    radial periods of that move; at speed 0 nothing moves and nothing is added.
    """
    distance_um = speed_um_s.clamp(min=0.0) * period_s
    if law == "proportional":
        mean_slope, variance_slope = table_one.PROPORTIONAL_MEAN_MN_UM, table_one.PROPORTIONAL_VARIANCE_MN2_UM
        mean_intercept = variance_intercept = (0.0, 0.0)
    else:
        mean_slope, variance_slope = table_one.MEASURED_MEAN_SLOPE_MN_UM, table_one.MEASURED_VARIANCE_SLOPE_MN2_UM
        mean_intercept = table_one.MEASURED_MEAN_INTERCEPT_MN
        variance_intercept = table_one.MEASURED_VARIANCE_INTERCEPT_MN2
    share = (distance_um > 0).to(distance_um) * (period_s / axial_period_s)
    return Expectation(
        distance_um * distance_um.new_tensor(mean_slope) + share * share.new_tensor(mean_intercept),
        distance_um * distance_um.new_tensor(variance_slope) + share * share.new_tensor(variance_intercept),
    )


def expect(
    speed_um_s: Tensor,
    mean_feedback_mN: Tensor,
    variance_feedback_mN2: Tensor,
    *,
    period_s: float,
    axial_period_s: float = 1.0,
    law: LawName = "proportional",
    doubling: bool = False,
) -> Expectation:
    """Look one period further ahead: feedback plus one period, so n uses give n times the law (Eq. 35).

    speed (batch, 1), feedbacks (batch, 2). `doubling` follows the printed Eq. 9 instead, 1, 2, 4, ... times the
    law: any feedback is doubled, and only an empty one, all zero, starts from the law.
    """
    one = one_period(speed_um_s, period_s=period_s, axial_period_s=axial_period_s, law=law)
    if not doubling:
        return Expectation(mean_feedback_mN + one.mean_mN, variance_feedback_mN2 + one.variance_mN2)
    first = ((mean_feedback_mN == 0) & (variance_feedback_mN2 == 0)).all(-1, keepdim=True)
    return Expectation(
        torch.where(first, one.mean_mN, 2 * mean_feedback_mN),
        torch.where(first, one.variance_mN2, 2 * variance_feedback_mN2),
    )


class ContactLaw(Region):
    """The region that computes `expect`."""

    config: ContactLawConfig

    def step(
        self, inputs: Mapping[str, Tensor], state: State, probe: Probe | None = None
    ) -> tuple[dict[str, Tensor], State]:
        """Look one period further ahead."""
        expectation = expect(
            inputs["speed"],
            inputs["mean_feedback"],
            inputs["variance_feedback"],
            period_s=self.config.period_s(self.clock),
            axial_period_s=self.clock.seconds(self.config.axial_period),
            law=self.config.law,
            doubling=self.config.doubling,
        )
        return {"mean": expectation.mean_mN, "variance": expectation.variance_mN2}, state
