"""The configuration of the teacher of an identified contact; imports no torch."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from neurorobo.clock import Clock
from neurorobo.regions import Port
from precision_interaction import table_one
from precision_interaction.rig.insertion_rig_config import MeasuredContactConfig, ProportionalContactConfig
from precision_interaction.teachers.analytic_config import AnalyticConfig, StartSpeed
from precision_interaction.teachers.contact_expectation_config import ContactLawConfig

IdentifiedContact = Annotated[ProportionalContactConfig | MeasuredContactConfig, Field(discriminator="law")]
"""What `neurorobo identify` writes."""


class IdentifiedLawConfig(AnalyticConfig):
    """The law of an identified contact (Eq. 1, 8, 35) as a teacher: speed -> mean and variance of the coming contact.

    It has the ports of `precision.law`, which teaches the paper's contact. Correlation and depth gain are not taught.
    """

    implementation: ClassVar[str] = "precision_interaction.rig.identified_law:IdentifiedLaw"

    type: Literal["precision.identified_law"] = "precision.identified_law"
    contact: IdentifiedContact = Field(
        default=ProportionalContactConfig(law="proportional"),
        description="What `neurorobo identify` wrote; the paper's if left out.",
    )
    period: str = Field(default="radial", description="Name of the period whose contact is expected, as under `time`.")
    start_speed: StartSpeed = Field(
        default=table_one.CREEP_SPEED_UM_S, description="The speed before anything is planned."
    )
    axial_period: str = Field(
        default="control", description="Name of the period of the axial moves; an intercept comes once with each."
    )

    def inputs(self, clock: Clock) -> dict[str, Port]:
        """Axial speed, and the expectation of the period before for looking further ahead."""
        return self._alike().inputs(clock)

    def outputs(self, clock: Clock) -> dict[str, Port]:
        """Mean and variance of the force that the contact adds up to this period."""
        return self._alike().outputs(clock)

    def _alike(self) -> ContactLawConfig:
        return ContactLawConfig.model_construct(
            period=self.period, start_speed=self.start_speed, axial_period=self.axial_period
        )
