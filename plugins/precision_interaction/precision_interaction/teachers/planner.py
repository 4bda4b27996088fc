"""The axial planner of Eq. 20-28: the teacher of the prefrontal cortex, block by block.

Tensors are (batch, 1) unless said otherwise: speeds in um/s, distances in um, forces (batch, 2) in mN.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

import torch
from torch import Tensor

from neurorobo.regions.region import Probe, Region, State
from precision_interaction import table_one
from precision_interaction.teachers.planner_config import PlannerConfig

WITHIN_ONE_DEVIATION = math.erf(math.sqrt(0.5)) ** 2  # T_p of Eq. 22


class AxialPlan(NamedTuple):
    """The planned speed and the next beta, and the two blocks behind them, (batch, 1) each."""

    speed_um_s: Tensor
    beta: Tensor
    confidence: Tensor
    terminal: Tensor


def assessment(
    force_mN: Tensor,
    speed_um_s: Tensor,
    *,
    gamma_a: float = table_one.GAMMA_A,
    creep_speed_um_s: float = table_one.CREEP_SPEED_UM_S,
) -> Tensor:
    """C_a of Eq. 20, in (-1, 1]: high for a small force (batch, 2) at a high speed.

    Speeds below creep count as creep.
    """
    force = force_mN.norm(dim=-1, keepdim=True)
    return 2.0 * torch.exp(-gamma_a * force / speed_um_s.clamp(min=creep_speed_um_s)) - 1.0


def confidence(
    forecast_mN: Tensor, variance_mN2: Tensor, *, unresolved_variance_mN2: float = table_one.UNRESOLVED_VARIANCE_MN2
) -> Tensor:
    """C_p of Eq. 21-22, in (0, 1]: how much of N(forecast, S) lies within one deviation of zero force.

    forecast and variance are (batch, 2) and belong to the n-th period ahead: the variance is that of all n periods.
    What the forecast cannot resolve adds to it, S = variance + unresolved_variance.
    """
    deviation_mN = (variance_mN2.clamp(min=0.0) + unresolved_variance_mN2).sqrt()
    offset = forecast_mN / (math.sqrt(2.0) * deviation_mN)
    one = math.sqrt(0.5)
    within = 0.5 * (torch.erf(one - offset) + torch.erf(one + offset))
    return within.prod(dim=-1, keepdim=True) / WITHIN_ONE_DEVIATION


def next_beta(beta: Tensor, assessment: Tensor) -> Tensor:
    """Beta of Eq. 23, clipped to [0, 1]."""
    return ((1.0 + assessment) * beta).clamp(0.0, 1.0)


def desired_speed(
    speed_um_s: Tensor,
    beta: Tensor,
    assessment: Tensor,
    confidence: Tensor,
    *,
    period_s: float = 1.0,
    threshold: float = table_one.T_N,
    creep_speed_um_s: float = table_one.CREEP_SPEED_UM_S,
    max_speed_um_s: float = table_one.MAX_SPEED_UM_S,
    max_acceleration_um_s2: float = table_one.MAX_ACCELERATION_UM_S2,
) -> Tensor:
    """The speed of Eq. 24-25 and the lower rows of Eq. 27: from creep to the maximum, within the acceleration limit."""
    desired = (1.0 + beta + (1.0 + assessment) * (confidence - threshold)) * speed_um_s
    change = max_acceleration_um_s2 * period_s
    bounded = desired.clamp(creep_speed_um_s, max_speed_um_s)
    return torch.clamp(bounded, speed_um_s - change, speed_um_s + change)


def stopping_speed(
    remaining_um: Tensor, *, period_s: float = 1.0, max_acceleration_um_s2: float = table_one.MAX_ACCELERATION_UM_S2
) -> Tensor:
    """The largest v whose chain v, v - a dt, v - 2 a dt, ... (while positive) covers at most the remaining distance.

    The exact form of Eq. 26 for speeds that are held for a period; following the chain ends on the last micrometre.
    """
    change_um_s = max_acceleration_um_s2 * period_s
    links = remaining_um.clamp(min=0.0) / (change_um_s * period_s)  # the distance in units of the shortest chain
    length = torch.ceil((torch.sqrt(1.0 + 8.0 * links) - 1.0) / 2.0).clamp(min=1.0)
    return change_um_s * (links / length + (length - 1.0) / 2.0)


def plan(
    force_mN: Tensor,
    forecast_mN: Tensor,
    variance_mN2: Tensor,
    remaining_um: Tensor,
    speed_um_s: Tensor,
    beta: Tensor,
    *,
    period_s: float = 1.0,
    gamma_a: float = table_one.GAMMA_A,
    threshold: float = table_one.T_N,
    unresolved_variance_mN2: float = table_one.UNRESOLVED_VARIANCE_MN2,
    creep_speed_um_s: float = table_one.CREEP_SPEED_UM_S,
    max_speed_um_s: float = table_one.MAX_SPEED_UM_S,
    max_acceleration_um_s2: float = table_one.MAX_ACCELERATION_UM_S2,
    max_braking_um_s2: float | None = None,
    aim_past_um: float = 0.0,
) -> AxialPlan:
    """The whole planner, Eq. 20-28: force, forecast, variance (batch, 2); remaining distance, speed, beta (batch, 1).

    The variance is that of the n-th imagined period, n Sigma of Eq. 22. The terminal signal is 1 when the desired speed
    exceeds the stopping speed, which then is the plan; too fast for that, it brakes with ``max_braking_um_s2``, by
    default the largest acceleration, and in the end moves what is left (Eq. 27). With ``aim_past_um`` it plans to stop
    that far past the end: the command layer stops at the end, and a pupil whose speeds fall short still arrives.
    """
    current = assessment(force_mN, speed_um_s, gamma_a=gamma_a, creep_speed_um_s=creep_speed_um_s)
    future = confidence(forecast_mN, variance_mN2, unresolved_variance_mN2=unresolved_variance_mN2)
    new_beta = next_beta(beta, current)
    desired_um_s = desired_speed(
        speed_um_s,
        new_beta,
        current,
        future,
        period_s=period_s,
        threshold=threshold,
        creep_speed_um_s=creep_speed_um_s,
        max_speed_um_s=max_speed_um_s,
        max_acceleration_um_s2=max_acceleration_um_s2,
    )
    left_um = remaining_um + aim_past_um
    stopping_um_s = stopping_speed(left_um, period_s=period_s, max_acceleration_um_s2=max_acceleration_um_s2)
    terminal = (desired_um_s > stopping_um_s).to(desired_um_s)
    braking_um_s2 = max_acceleration_um_s2 if max_braking_um_s2 is None else max_braking_um_s2
    braked_um_s = torch.maximum(stopping_um_s, speed_um_s - braking_um_s2 * period_s)
    planned_um_s = torch.minimum(torch.minimum(desired_um_s, braked_um_s), left_um / period_s)
    return AxialPlan(planned_um_s, new_beta, future, terminal)


class AxialPlanner(Region):
    """The region that computes `plan`."""

    config: PlannerConfig

    def step(
        self, inputs: Mapping[str, Tensor], state: State, probe: Probe | None = None
    ) -> tuple[dict[str, Tensor], State]:
        """Plan one axial move."""
        planned = plan(
            inputs["force"],
            inputs["forecast"],
            inputs["variance"],
            inputs["remaining"],
            inputs["speed"],
            inputs["beta"],
            period_s=self.config.period_s(self.clock),
            gamma_a=self.config.gamma_a,
            threshold=self.config.threshold,
            unresolved_variance_mN2=self.config.unresolved_variance,
            creep_speed_um_s=self.config.creep_speed,
            max_speed_um_s=self.config.max_speed,
            max_acceleration_um_s2=self.config.max_acceleration,
            max_braking_um_s2=self.config.max_braking,
            aim_past_um=self.config.aim_past,
        )
        return as_outputs(planned), state


def as_outputs(planned: AxialPlan) -> dict[str, Tensor]:
    """Return a plan under the names of the output ports."""
    return {
        "speed": planned.speed_um_s,
        "beta": planned.beta,
        "confidence": planned.confidence,
        "terminal": planned.terminal,
    }
