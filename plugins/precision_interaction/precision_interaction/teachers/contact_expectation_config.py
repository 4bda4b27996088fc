"""The configuration of the teacher of the hippocampus; imports no torch."""

from typing import ClassVar, Literal

from pydantic import Field

from neurorobo.clock import Clock
from neurorobo.errors import ConfigError, Fault
from neurorobo.regions import Port
from precision_interaction import table_one
from precision_interaction.teachers.analytic_config import AnalyticConfig, StartSpeed


class ContactLawConfig(AnalyticConfig):
    """The contact law itself (Eq. 1, 8, 35): speed -> mean and variance of the coming contact."""

    implementation: ClassVar[str] = "precision_interaction.teachers.contact_expectation:ContactLaw"

    type: Literal["precision.law"] = "precision.law"

    period: str = Field(default="radial", description="Name of the period whose contact is expected, as under `time`.")
    start_speed: StartSpeed = Field(
        default=table_one.CREEP_SPEED_UM_S, description="The speed before anything is planned."
    )
    law: Literal["proportional", "measured"] = "proportional"
    doubling: bool = Field(default=False, description="Double at every look ahead, as Eq. 9 is printed; Eq. 35 adds.")
    axial_period: str = Field(
        default="control", description="Name of the period of the axial moves; the measured law starts anew with each."
    )

    def inputs(self, clock: Clock) -> dict[str, Port]:
        """Axial speed, and the expectation of the period before for looking further ahead."""
        self.period_s(clock)
        if self.axial_period not in clock.periods_ns:
            raise ConfigError([Fault(("axial_period",), f"there is no period `{self.axial_period}` under `time`")])
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
