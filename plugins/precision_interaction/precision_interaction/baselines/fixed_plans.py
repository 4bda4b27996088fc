"""Axial plans that look at no force: fixed steps (ref. [3]) and the trapezoid (ref. [7])."""

from collections.abc import Mapping

import torch
from torch import Tensor

from neurorobo.regions.region import Probe, Region, State
from precision_interaction.baselines.fixed_plans_config import FixedStepConfig, TrapezoidConfig
from precision_interaction.teachers.planner import stopping_speed
from precision_interaction.teachers.planner_config import AxialPlannerConfig


def _without_forces(
    config: AxialPlannerConfig, period_s: float, wanted_um_s: Tensor, inputs: Mapping[str, Tensor]
) -> dict[str, Tensor]:
    """Outputs of a planner that looks at no force: it brakes for the end, is always confident and keeps beta."""
    stopping_um_s = stopping_speed(
        inputs["remaining"], period_s=period_s, max_acceleration_um_s2=config.max_acceleration
    )
    return {
        "speed": torch.minimum(wanted_um_s, stopping_um_s),
        "beta": inputs["beta"],
        "confidence": torch.ones_like(wanted_um_s),
        "terminal": (wanted_um_s > stopping_um_s).to(wanted_um_s),
    }


class TrapezoidPlanner(Region):
    """Largest acceleration, cruise, largest deceleration, ending on the last micrometre; looks at no force."""

    config: TrapezoidConfig

    def step(
        self, inputs: Mapping[str, Tensor], state: State, probe: Probe | None = None
    ) -> tuple[dict[str, Tensor], State]:
        """Plan one axial move."""
        period_s = self.config.period_s(self.clock)
        wanted_um_s = inputs["speed"] + self.config.max_acceleration * period_s
        return _without_forces(self.config, period_s, wanted_um_s.clamp(max=self.config.max_speed), inputs), state


class FixedStepPlanner(Region):
    """The same distance in every period, the rest in the last; looks at no force."""

    config: FixedStepConfig

    def step(
        self, inputs: Mapping[str, Tensor], state: State, probe: Probe | None = None
    ) -> tuple[dict[str, Tensor], State]:
        """Plan one axial move."""
        period_s = self.config.period_s(self.clock)
        wanted_um_s = torch.full_like(inputs["speed"], min(self.config.distance / period_s, self.config.max_speed))
        return _without_forces(self.config, period_s, wanted_um_s, inputs), state
