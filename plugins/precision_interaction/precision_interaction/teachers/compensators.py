"""The radial compensators of Eq. 14-19: teachers of the cerebellum.

Forces in mN, distances in um, speeds in um/s, all tensors (batch, 2). A positive move lowers the force (f <- f - M dm).
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

import torch
from torch import Tensor

from neurorobo.regions.region import Probe, Region, State
from precision_interaction import table_one
from precision_interaction.teachers.compensators_config import PredictiveConfig, ProfileConfig
from precision_interaction.teachers.planner import stopping_speed


class Compensation(NamedTuple):
    """One radial period's move, the force left after it (Eq. 19), and the velocity it ends with."""

    move_um: Tensor
    residual_mN: Tensor
    velocity_um_s: Tensor


def trust(variance_mN2: Tensor, *, sigma_0_mN: float = table_one.SIGMA_0_MN) -> Tensor:
    """gamma_r of Eq. 16 per axis: 1 up to a deviation of sigma_0, then the falling share within +-sigma_0."""
    deviation_mN = variance_mN2.clamp(min=0.0).sqrt()
    within = torch.erf(sigma_0_mN / (math.sqrt(2.0) * deviation_mN))  # a deviation of 0 gives erf(inf) = 1
    return (within / math.erf(math.sqrt(0.5))).clamp(max=1.0)


def profile(
    force_mN: Tensor,
    velocity_um_s: Tensor,
    mean_mN: Tensor,
    variance_mN2: Tensor,
    *,
    period_s: float,
    stiffness_mN_um: float = table_one.STIFFNESS_MN_UM,
    max_acceleration_um_s2: float = table_one.MAX_ACCELERATION_UM_S2,
    sigma_0_mN: float = table_one.SIGMA_0_MN,
    max_p1_s: float = 1.0,
) -> Compensation:
    """The paper's compensator: the Gaussian path p_2 exp(-(t - p_1)^2) of Eq. 14, followed over the whole period.

    Eq. 15 gives p_1 and p_2 from force and velocity. As printed, Eq. 19 takes one Euler step of the acceleration,
    which diverges at periods near 1 s, and p_1 = -M v / (2 f) has a pole at f = 0, hence its clip to +-max_p1_s.
    Eq. 18 limits the acceleration at the start of the path (Eq. 17); a path that is too steep is scaled down as a
    whole.
    """
    expected_mN = force_mN + trust(variance_mN2, sigma_0_mN=sigma_0_mN) * mean_mN
    start_um = -expected_mN / stiffness_mN_um
    some_um = torch.where(start_um == 0, torch.ones_like(start_um), start_um)  # a path of no height needs no p_1
    p1_s = (velocity_um_s / (2.0 * some_um)).clamp(-max_p1_s, max_p1_s)
    acceleration_um_s2 = (4.0 * p1_s**2 - 2.0) * start_um
    steepness = acceleration_um_s2.norm(dim=-1, keepdim=True) / max_acceleration_um_s2
    start_um = start_um / steepness.clamp(min=1.0)
    end_um = start_um * torch.exp(2.0 * period_s * p1_s - period_s**2)
    move_um = end_um - start_um
    return Compensation(move_um, force_mN - stiffness_mN_um * move_um, -2.0 * (period_s - p1_s) * end_um)


def predictive(
    force_mN: Tensor,
    velocity_um_s: Tensor,
    mean_mN: Tensor,
    variance_mN2: Tensor,
    *,
    period_s: float,
    stiffness_mN_um: float = table_one.STIFFNESS_MN_UM,
    max_acceleration_um_s2: float = table_one.MAX_ACCELERATION_UM_S2,
    sigma_0_mN: float = table_one.SIGMA_0_MN,
) -> Compensation:
    """The move that zeroes f + gamma_r mu at the period's end, within the acceleration limit and braking in time.

    The stage keeps up with the expected drift mu and takes the present force off no faster than it can still brake
    from, by the planner's exact chain. Each axis gets 1/sqrt(2) of the acceleration, so that the two together stay
    within the limit.
    """
    acceleration_um_s2 = max_acceleration_um_s2 / math.sqrt(2.0)
    change_um_s = acceleration_um_s2 * period_s
    drift_um_s = trust(variance_mN2, sigma_0_mN=sigma_0_mN) * mean_mN / (stiffness_mN_um * period_s)
    closing_um_s = stopping_speed(
        force_mN.abs() / stiffness_mN_um, period_s=period_s, max_acceleration_um_s2=acceleration_um_s2
    )
    wanted_um_s = drift_um_s + force_mN.sign() * closing_um_s
    new_velocity_um_s = torch.clamp(wanted_um_s, velocity_um_s - change_um_s, velocity_um_s + change_um_s)
    move_um = new_velocity_um_s * period_s
    return Compensation(move_um, force_mN - stiffness_mN_um * move_um, new_velocity_um_s)


class ProfileCompensator(Region):
    """The region that computes `profile`."""

    config: ProfileConfig

    def step(
        self, inputs: Mapping[str, Tensor], state: State, probe: Probe | None = None
    ) -> tuple[dict[str, Tensor], State]:
        """Plan one radial period's move."""
        compensation = profile(
            inputs["force"],
            inputs["velocity"],
            inputs["mean"],
            inputs["variance"],
            period_s=self.config.period_s(self.clock),
            stiffness_mN_um=self.config.stiffness,
            max_acceleration_um_s2=self.config.max_acceleration,
            sigma_0_mN=self.config.sigma_0,
            max_p1_s=self.config.max_p1,
        )
        return as_outputs(compensation), state


class PredictiveCompensator(Region):
    """The region that computes `predictive`."""

    config: PredictiveConfig

    def step(
        self, inputs: Mapping[str, Tensor], state: State, probe: Probe | None = None
    ) -> tuple[dict[str, Tensor], State]:
        """Plan one radial period's move."""
        compensation = predictive(
            inputs["force"],
            inputs["velocity"],
            inputs["mean"],
            inputs["variance"],
            period_s=self.config.period_s(self.clock),
            stiffness_mN_um=self.config.stiffness,
            max_acceleration_um_s2=self.config.max_acceleration,
            sigma_0_mN=self.config.sigma_0,
        )
        return as_outputs(compensation), state


def as_outputs(compensation: Compensation) -> dict[str, Tensor]:
    """Return a compensation under the names of the output ports."""
    return {
        "move": compensation.move_um,
        "residual": compensation.residual_mN,
        "velocity": compensation.velocity_um_s,
    }
