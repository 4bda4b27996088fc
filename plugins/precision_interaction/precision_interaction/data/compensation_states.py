"""Training data of the cerebellum: states of the radial loop, as they occur and beyond; the module imports no torch."""

from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from pydantic import Field

from neurorobo.clock import Clock
from neurorobo.learning.phase import DataConfig
from neurorobo.units import Interval, Unit
from precision_interaction import table_one
from precision_interaction.regions.cerebellum_config import default_ranges

if TYPE_CHECKING:
    import torch
    from torch import Tensor


class CompensationStatesConfig(DataConfig):
    """Force, velocity and expected contact of single radial periods.

    Most states are like those of a running insertion: any axial speed, often the largest, the contact expected there,
    small forces, and a velocity that follows the contact. A tenth or so of each quantity is spread evenly over all that
    can occur instead.
    """

    implementation: ClassVar[str] = "precision_interaction.data.compensation_states:CompensationStates"

    type: Literal["precision.compensation_states"] = "precision.compensation_states"
    period: str = Field(default="radial", description="Name of the period of the radial moves, as under `time`.")
    max_speed: Annotated[float, Unit("um/s", gt=0)] = Field(
        default=table_one.MAX_SPEED_UM_S, description="Largest axial speed."
    )
    force: Annotated[Interval, Unit("mN")] | None = Field(
        default=None, description="Range of forces; the cerebellum's if left out."
    )
    velocity: Annotated[Interval, Unit("um/s")] | None = Field(
        default=None, description="Range of velocities; the cerebellum's if left out."
    )


class CompensationStates:
    """Draws states for the cerebellum and its teacher."""

    def __init__(self, config: CompensationStatesConfig, clock: Clock) -> None:
        self.period_s = clock.seconds(config.period)
        default = default_ranges(self.period_s)
        self.max_speed_um_s = config.max_speed
        self.force_mN = config.force or default["force"]
        self.velocity_um_s = config.velocity or default["velocity"]

    def draw(self, batch: int, generator: "torch.Generator") -> "dict[str, Tensor]":
        """Return force (mN), velocity (um/s), mean (mN) and variance (mN^2) of the contact, (batch, 2) each."""
        import torch

        def uniform(width: int = 2) -> "Tensor":
            return torch.rand(batch, width, generator=generator)

        def normal() -> "Tensor":
            return torch.randn(batch, 2, generator=generator)

        def spread(share: float, values: "Tensor", lo: float, hi: float) -> "Tensor":
            return torch.where(uniform() < share, lo + uniform() * (hi - lo), values)

        period_s = self.period_s
        touching = (uniform(1) > 0.12).float()
        cruising = 1.0 - 0.04 * uniform(1)
        share = torch.where(uniform(1) < 0.3, cruising, uniform(1)) * touching
        distance_um = share * self.max_speed_um_s * period_s
        forgetful = 2.5 * period_s  # the expectation is that of a spiking network
        mean_mN = distance_um * torch.tensor(table_one.PROPORTIONAL_MEAN_MN_UM) + forgetful * normal()
        variance_mN2 = distance_um * torch.tensor(table_one.PROPORTIONAL_VARIANCE_MN2_UM) + forgetful * normal()
        furthest_um = 1.1 * self.max_speed_um_s * period_s
        mean_mN = spread(0.1, mean_mN, 0.0, furthest_um * max(table_one.PROPORTIONAL_MEAN_MN_UM)).clamp(min=0)
        variance_mN2 = spread(0.1, variance_mN2, 0.0, furthest_um * max(table_one.PROPORTIONAL_VARIANCE_MN2_UM))
        deviation_mN = torch.where(uniform() < 0.3, 2.5, 1.0) * (5.0 + 10.0 * period_s)
        force_mN = spread(0.15, deviation_mN * normal(), self.force_mN.lo, self.force_mN.hi)
        drift_um_s = mean_mN / (table_one.STIFFNESS_MN_UM * period_s) + 0.6 * normal()
        sensor_mN = table_one.FORCE_RESOLUTION_MN
        measured_mN = torch.where(uniform(1) < 0.5, (force_mN / sensor_mN).round() * sensor_mN, force_mN)
        return {
            "force": measured_mN,
            "velocity": spread(0.15, drift_um_s, self.velocity_um_s.lo, self.velocity_um_s.hi),
            "mean": mean_mN,
            "variance": variance_mN2.clamp(min=0),
        }
