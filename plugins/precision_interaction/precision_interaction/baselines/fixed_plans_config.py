"""The configurations of the axial plans that look at no force; imports no torch."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from neurorobo.units import Unit
from precision_interaction.teachers.analytic_config import StartSpeed
from precision_interaction.teachers.planner_config import AxialPlannerConfig


class TrapezoidConfig(AxialPlannerConfig):
    """Largest acceleration, cruise, largest deceleration: the axial plan of the paper's ref. [7]."""

    implementation: ClassVar[str] = "precision_interaction.baselines.fixed_plans:TrapezoidPlanner"
    forces_optional: ClassVar[bool] = True

    type: Literal["precision.trapezoid"] = "precision.trapezoid"
    start_speed: StartSpeed = Field(default=0.0, description="The speed before anything is planned.")


class FixedStepConfig(AxialPlannerConfig):
    """The same axial distance in every period: the plan of the paper's ref. [3]."""

    implementation: ClassVar[str] = "precision_interaction.baselines.fixed_plans:FixedStepPlanner"
    forces_optional: ClassVar[bool] = True

    type: Literal["precision.fixed_step"] = "precision.fixed_step"
    distance: Annotated[float, Unit("um", gt=0)] = Field(default=20.0, description="Axial distance per period.")
