"""The configuration of the prefrontal cortex's teacher, and the ports of what stands in for it; imports no torch."""

from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from neurorobo.clock import Clock
from neurorobo.regions import Port
from neurorobo.units import Unit
from precision_interaction import table_one
from precision_interaction.teachers.analytic_config import Acceleration, AnalyticConfig, Speed, StartSpeed


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

    implementation: ClassVar[str] = "precision_interaction.teachers.planner:AxialPlanner"

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
    max_braking: Acceleration | None = Field(
        default=None,
        description="Braking when too fast to stop at the end; by default `max_acceleration`, at least that.",
    )
    aim_past: Annotated[float, Unit("um", ge=0)] = Field(
        default=0.0, description="How far past the end to plan the stop, for a pupil that may fall short of its speed."
    )

    @model_validator(mode="after")
    def _brakes_as_hard_as_it_speeds_up(self) -> Self:
        if self.max_braking is not None and self.max_braking < self.max_acceleration:
            raise ValueError(
                f"max_braking, {self.max_braking:g} um/s^2, must not be below max_acceleration, "
                f"{self.max_acceleration:g} um/s^2"
            )
        return self
