"""The configurations of the analytic regions: the teachers of the three spiking regions, and the baselines.

Their ports bear the names of the spiking regions' ports, so that one line of a file swaps one for the other.
Nothing here imports torch.
"""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from neurorobo.clock import Clock
from neurorobo.errors import ConfigError, Fault
from neurorobo.regions import Port, RegionConfig
from neurorobo.units import Unit
from precision_interaction import table_one

Speed = Annotated[float, Unit("um/s", gt=0)]
StartSpeed = Annotated[float, Unit("um/s", ge=0)]
Acceleration = Annotated[float, Unit("um/s^2", gt=0)]
Distance = Annotated[float, Unit("um", gt=0)]
Stiffness = Annotated[float, Unit("mN/um", gt=0)]
Gain = Annotated[float, Unit("1", ge=0)]


class AnalyticConfig(RegionConfig):
    """Base of the regions that compute with numbers and know the length of their period."""

    period: str = Field(description="Name of the period at which the region acts, as under `time`.")

    def period_s(self, clock: Clock) -> float:
        """Return the length of the period; a ConfigError if the clock has none of that name."""
        return clock.seconds(self.period)


class ContactExpectationConfig(AnalyticConfig):
    """Base of what stands in for the hippocampus: speed -> mean and variance of the coming contact."""

    period: str = Field(default="radial", description="Name of the period whose contact is expected, as under `time`.")
    start_speed: StartSpeed = Field(
        default=table_one.CREEP_SPEED_UM_S, description="The speed before anything is planned."
    )

    def inputs(self, clock: Clock) -> dict[str, Port]:
        """Axial speed, and the expectation of the period before for looking further ahead."""
        self.period_s(clock)
        return {
            "speed": Port("um/s", initial=(self.start_speed,), description="Axial speed of the period."),
            "mean_feedback": Port("mN", 2, initial=(0.0, 0.0), description="Mean up to the period before."),
            "variance_feedback": Port("mN^2", 2, initial=(0.0, 0.0), description="Variance up to the period before."),
        }

    def outputs(self, clock: Clock) -> dict[str, Port]:
        """Mean and variance of the force that the contact adds up to this period."""
        return {
            "mean": Port("mN", 2, description="Expected change of the radial force."),
            "variance": Port("mN^2", 2, description="Its variance."),
        }


class ContactLawConfig(ContactExpectationConfig):
    """The contact law itself (Eq. 1, 8, 35)."""

    implementation: ClassVar[str] = "precision_interaction.contact_law:ContactLaw"

    type: Literal["precision.law"] = "precision.law"
    law: Literal["proportional", "measured"] = "proportional"
    doubling: bool = Field(default=False, description="Double at every look ahead, as Eq. 9 is printed; Eq. 35 adds.")
    axial_period: str = Field(
        default="control", description="Name of the period of the axial moves; the measured law starts anew with each."
    )

    def inputs(self, clock: Clock) -> dict[str, Port]:
        """Axial speed, and the expectation of the period before for looking further ahead."""
        if self.axial_period not in clock.periods_ns:
            raise ConfigError([Fault(("axial_period",), f"there is no period `{self.axial_period}` under `time`")])
        return super().inputs(clock)


class ApproachConfig(AnalyticConfig):
    """Knows the gap: passes the speed on, or 0 while the coming period ends inside the gap."""

    implementation: ClassVar[str] = "precision_interaction.contact_law:Approach"

    type: Literal["precision.approach"] = "precision.approach"
    period: str = Field(default="radial", description="Name of the period whose contact is expected, as under `time`.")
    length: Distance = Field(default=table_one.LENGTH_UM, description="l: the axial travel, the gap included.")
    gap: Annotated[float, Unit("um", ge=0)] = Field(
        default=table_one.GAP_UM, description="Axial travel before contact."
    )

    def inputs(self, clock: Clock) -> dict[str, Port]:
        """Planned axial speed and the distance left."""
        self.period_s(clock)
        return {"speed": Port("um/s"), "remaining": Port("um")}

    def outputs(self, clock: Clock) -> dict[str, Port]:
        """The speed at which contact is to be expected."""
        return {"speed": Port("um/s")}


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

    implementation: ClassVar[str] = "precision_interaction.compensators:ProfileCompensator"

    type: Literal["precision.profile"] = "precision.profile"
    max_p1: Annotated[float, Unit("s", gt=0)] = Field(
        default=1.0, description="Largest shift p_1 of the path in time; unlimited it has a pole at zero force."
    )


class PredictiveConfig(_TeacherConfig):
    """The compensator that zeroes the expected force within the acceleration limit, braking in time."""

    implementation: ClassVar[str] = "precision_interaction.compensators:PredictiveCompensator"

    type: Literal["precision.predictive"] = "precision.predictive"


class PidConfig(CompensatorConfig):
    """A PID controller of the radial force, without any expectation.

    The move is (kp e + ki sum(e) + kd (e - e')) / M, where e is the force and e' the force before; gains are per
    period. The defaults are the PI controller of the paper's ref. [3]; kp: 1 and ki: 0 make the compensation of its
    ref. [7].
    """

    implementation: ClassVar[str] = "precision_interaction.baselines:PidCompensator"
    expectation_optional: ClassVar[bool] = True

    type: Literal["precision.pid"] = "precision.pid"
    carry: Literal["never", "repeat", "always"] = "always"
    kp: Gain = 0.5
    ki: Gain = 0.3
    kd: Gain = 0.0
    max_acceleration: Acceleration | None = Field(
        default=None, description="Largest radial acceleration, both axes together; without one if left out."
    )


class AxialPlannerConfig(AnalyticConfig):
    """Base of what stands in for the prefrontal cortex: forces, distance and past performance -> axial speed."""

    period: str = Field(default="control", description="Name of the period of the axial moves, as under `time`.")
    start_speed: StartSpeed = Field(
        default=table_one.CREEP_SPEED_UM_S, description="The speed before anything is planned."
    )
    beta_0: Annotated[float, Unit("1", ge=0, le=1)] = Field(
        default=table_one.BETA_0, description="Beta at the start (Eq. 23)."
    )
    max_speed: Speed = Field(default=table_one.MAX_SPEED_UM_S, description="Largest axial speed.")
    max_acceleration: Acceleration = Field(
        default=table_one.MAX_ACCELERATION_UM_S2, description="Largest change of the axial speed."
    )

    forces_optional: ClassVar[bool] = False

    def inputs(self, clock: Clock) -> dict[str, Port]:
        """Radial force now and n periods ahead, the n periods' variance, distance left, and what was planned before."""
        self.period_s(clock)
        nothing = (0.0, 0.0) if self.forces_optional else None
        return {
            "force": Port("mN", 2, initial=nothing, description="Radial force now."),
            "forecast": Port(
                "mN", 2, initial=nothing, description="Force expected n periods ahead, residual and contact."
            ),
            "variance": Port(
                "mN^2", 2, initial=nothing, description="Variance of n periods' contact, n times that of one."
            ),
            "remaining": Port("um", description="Axial distance left."),
            "speed": Port("um/s", initial=(self.start_speed,), description="Axial speed planned before."),
            "beta": Port("1", initial=(self.beta_0,), description="Confidence in past performance (Eq. 23)."),
        }

    def outputs(self, clock: Clock) -> dict[str, Port]:
        """The planned axial speed and beta, and the two blocks' values behind them."""
        return {
            "speed": Port("um/s", description="Planned axial speed."),
            "beta": Port("1", description="Confidence in past performance (Eq. 23)."),
            "confidence": Port("1", description="C_p: confidence in the forecast (Eq. 21-22)."),
            "terminal": Port("1", description="s_l: 1 when it is time to brake for the end (Eq. 26)."),
        }


class PlannerConfig(AxialPlannerConfig):
    """The paper's axial planner (Eq. 20-28)."""

    implementation: ClassVar[str] = "precision_interaction.planner:AxialPlanner"

    type: Literal["precision.planner"] = "precision.planner"
    gamma_a: Annotated[float, Unit("um/s/mN", gt=0)] = Field(
        default=table_one.GAMMA_A, description="Scale of the current assessment (Eq. 20)."
    )
    threshold: Annotated[float, Unit("1", ge=0, le=1)] = Field(
        default=table_one.T_N, description="T_n: confidence above which the forecast speeds the insertion up (Eq. 24)."
    )
    unresolved_variance: Annotated[float, Unit("mN^2", gt=0)] = Field(
        default=table_one.UNRESOLVED_VARIANCE_MN2,
        description="R: what the forecast cannot resolve, added to its variance: by default the resolutions of stage "
        "and sensor; a trained cerebellum's own error is not in it.",
    )
    creep_speed: Speed = Field(default=table_one.CREEP_SPEED_UM_S, description="Least speed on the way.")


class TrapezoidConfig(AxialPlannerConfig):
    """Largest acceleration, cruise, largest deceleration: the axial plan of the paper's ref. [7]."""

    implementation: ClassVar[str] = "precision_interaction.baselines:TrapezoidPlanner"
    forces_optional: ClassVar[bool] = True

    type: Literal["precision.trapezoid"] = "precision.trapezoid"
    start_speed: StartSpeed = Field(default=0.0, description="The speed before anything is planned.")


class FixedStepConfig(AxialPlannerConfig):
    """The same axial distance in every period: the plan of the paper's ref. [3]."""

    implementation: ClassVar[str] = "precision_interaction.baselines:FixedStepPlanner"
    forces_optional: ClassVar[bool] = True

    type: Literal["precision.fixed_step"] = "precision.fixed_step"
    distance: Distance = Field(default=20.0, description="Axial distance per period.")
