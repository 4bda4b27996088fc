"""Training data of the prefrontal cortex: situations on the way to the end; its configuration is torch-free."""

from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from pydantic import Field

from neurorobo.clock import Clock
from neurorobo.learning.phase import DataConfig
from neurorobo.units import Interval, Unit
from precision_interaction import table_one

if TYPE_CHECKING:
    import torch
    from torch import Tensor

# Largest deviation per axis of force and forecast in a run that goes well: twice what the analytic controllers leave.
FORCE_MN = 35.0
FORECAST_MN = 20.0


class PlanningStatesConfig(DataConfig):
    """States for the planner and the prefrontal cortex, made up without simulating a run.

    Distance, speed and beta always cover their ranges, densest where one brakes. Forces and variances are those of a
    run that goes well or, for the share `off_policy`, anything up to `largest_force` and `largest_variance`.
    """

    implementation: ClassVar[str] = "precision_interaction.data.planning_states:PlanningStates"

    type: Literal["precision.planning_states"] = "precision.planning_states"
    length: Annotated[float, Unit("um", gt=0)] = table_one.LENGTH_UM
    braking: Annotated[float, Unit("um", gt=0)] = Field(
        default=450.0, description="The last part of the length, from which half of the states come."
    )
    max_speed: Annotated[float, Unit("um/s", gt=0)] = table_one.MAX_SPEED_UM_S
    max_acceleration: Annotated[float, Unit("um/s^2", gt=0)] = Field(
        default=table_one.MAX_ACCELERATION_UM_S2, description="The teacher's, which shapes the braking."
    )
    off_policy: Annotated[float, Unit("1", ge=0, le=1)] = 0.5
    largest_force: Annotated[float, Unit("mN", gt=0)] = Field(
        default=60.0, description="Per axis; so for the forecast."
    )
    largest_variance: Annotated[float, Unit("mN^2", gt=0)] = 360.0
    radial_periods: Annotated[Interval, Unit("s")] = Field(
        default=Interval(0.05, 1.0),
        description="What is imagined, and so its variance, may be of shorter periods than the axial ones.",
    )


class PlanningStates:
    """Draws states for the prefrontal cortex and its teacher."""

    def __init__(self, config: PlanningStatesConfig, clock: Clock) -> None:
        self._config = config

    def draw(self, batch: int, generator: "torch.Generator") -> "dict[str, Tensor]":
        """Return force, forecast (mN), variance (mN^2), remaining (um), speed (um/s) and beta, (batch, width) each."""
        import torch

        from precision_interaction.teachers.planner import stopping_speed

        config = self._config

        def uniform(lo: float, hi: float, width: int = 1) -> "Tensor":
            return lo + (hi - lo) * torch.rand(batch, width, generator=generator)

        def mixture(shares: list[float], *kinds: "Tensor") -> "Tensor":
            kind = torch.multinomial(torch.tensor(shares), batch, replacement=True, generator=generator)
            return torch.stack(kinds)[kind, torch.arange(batch)]

        def normal(largest_deviation: float) -> "Tensor":
            return torch.randn(batch, 2, generator=generator) * uniform(0.0, largest_deviation)

        remaining_um = mixture(
            [0.35, 0.15, 0.35, 0.15],
            uniform(0.0, config.length),
            uniform(0.95 * config.length, config.length),
            uniform(0.0, config.braking),
            uniform(0.0, 0.15 * config.braking),
        )
        change_um_s = config.max_acceleration  # in one axial period of 1 s
        braking_um_s = stopping_speed(remaining_um, max_acceleration_um_s2=config.max_acceleration)
        speed_um_s = mixture(
            [0.3, 0.15, 0.4, 0.15],
            uniform(0.0, config.max_speed),
            torch.full((batch, 1), config.max_speed),
            braking_um_s + uniform(-1.2 * change_um_s, 1.2 * change_um_s),
            uniform(0.0, 1.2 * change_um_s),
        ).clamp(0.0, config.max_speed)
        beta = mixture([0.5, 0.5], torch.ones(batch, 1), uniform(0.0, 1.0))
        share = [1.0 - config.off_policy, config.off_policy]
        lo, hi = config.radial_periods.lo, config.radial_periods.hi
        imagined_um = table_one.IMAGINED_PERIODS * speed_um_s * lo * (hi / lo) ** uniform(0.0, 1.0)
        expected_mN2 = imagined_um * torch.tensor(table_one.PROPORTIONAL_VARIANCE_MN2_UM)
        return {
            "force": mixture(share, normal(FORCE_MN), uniform(-config.largest_force, config.largest_force, 2)),
            "forecast": mixture(share, normal(FORECAST_MN), uniform(-config.largest_force, config.largest_force, 2)),
            "variance": mixture(
                share, expected_mN2 * uniform(0.8, 1.2, 2), uniform(0.0, config.largest_variance, 2)
            ).clamp(max=config.largest_variance),
            "remaining": remaining_um,
            "speed": speed_um_s,
            "beta": beta,
        }
