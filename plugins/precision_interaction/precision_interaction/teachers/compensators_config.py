"""The configurations of the cerebellum's teachers, and the ports of all that stands in for it; imports no torch."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from neurorobo.clock import Clock
from neurorobo.regions import Port
from neurorobo.units import Unit
from precision_interaction import table_one
from precision_interaction.teachers.analytic_config import Acceleration, AnalyticConfig

Stiffness = Annotated[float, Unit("mN/um", gt=0)]


class CompensatorConfig(AnalyticConfig):
    """Base of what stands in for the cerebellum: force and expected contact -> radial move and the force left."""

    period: str = Field(default="radial", description="Name of the period of the radial moves, as under `time`.")
    stiffness: Stiffness = Field(default=table_one.STIFFNESS_MN_UM, description="M: force taken off by a radial move.")

    expectation_optional: ClassVar[bool] = False

    def inputs(self, clock: Clock) -> dict[str, Port]:
        """Radial force, radial velocity of the period before, and mean and variance of the contact to come."""
        self.period_s(clock)
        nothing = (0.0, 0.0) if self.expectation_optional else None
        return {
            "force": Port("mN", 2, description="Radial force."),
            "velocity": Port("um/s", 2, initial=(0.0, 0.0), description="Radial velocity of the period before."),
            "mean": Port("mN", 2, initial=nothing, description="Expected change of the force in this period."),
            "variance": Port("mN^2", 2, initial=nothing, description="Its variance."),
        }

    def outputs(self, clock: Clock) -> dict[str, Port]:
        """The radial move, the force left after it (Eq. 19), and the velocity it ends with."""
        return {
            "move": Port("um", 2, description="Radial move; a positive one lowers the force."),
            "residual": Port("mN", 2, description="Force left after the move, without the contact of the period."),
            "velocity": Port("um/s", 2, description="Radial velocity at the period's end."),
        }


class _TeacherConfig(CompensatorConfig):
    max_acceleration: Acceleration = Field(
        default=table_one.MAX_ACCELERATION_UM_S2, description="Largest radial acceleration, both axes together."
    )
    sigma_0: Annotated[float, Unit("mN", gt=0)] = Field(
        default=table_one.SIGMA_0_MN,
        description="Deviation up to which the expected contact is trusted fully (Eq. 16).",
    )


class ProfileConfig(_TeacherConfig):
    """The paper's compensator: a Gaussian path back to zero force (Eq. 14-19)."""

    implementation: ClassVar[str] = "precision_interaction.teachers.compensators:ProfileCompensator"

    type: Literal["precision.profile"] = "precision.profile"
    max_p1: Annotated[float, Unit("s", gt=0)] = Field(
        default=1.0, description="Largest shift p_1 of the path in time; unlimited it has a pole at zero force."
    )


class PredictiveConfig(_TeacherConfig):
    """The compensator that zeroes the expected force within the acceleration limit, braking in time."""

    implementation: ClassVar[str] = "precision_interaction.teachers.compensators:PredictiveCompensator"

    type: Literal["precision.predictive"] = "precision.predictive"
