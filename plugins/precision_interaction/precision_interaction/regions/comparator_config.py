"""The configuration of the comparison of the contact felt with the one expected; imports no torch."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from neurorobo.clock import Clock
from neurorobo.regions import Port, RegionConfig
from neurorobo.units import Unit
from precision_interaction import table_one


class ComparatorConfig(RegionConfig):
    """Feels the contact of the period before, and tells in what it differed from the one expected."""

    implementation: ClassVar[str] = "precision_interaction.regions.comparator:Comparator"

    type: Literal["precision.comparator"] = "precision.comparator"
    carry: Literal["never", "repeat", "always"] = "always"
    stiffness: Annotated[float, Unit("mN/um", gt=0)] = Field(
        default=table_one.STIFFNESS_MN_UM, description="M: what a radial move is believed to take off the force."
    )
    force_resolution: Annotated[float, Unit("mN", ge=0)] = Field(
        default=table_one.FORCE_RESOLUTION_MN, description="The sensor's count, whose rounding is no contact."
    )

    def inputs(self, clock: Clock) -> dict[str, Port]:
        """Radial force and position now, and what was expected of the period before."""
        return {
            "force": Port("mN", 2, description="Radial force."),
            "stage": Port("um", 2, description="Radial position."),
            "mean": Port("mN", 2, initial=(0.0, 0.0), description="Contact expected of the period before."),
            "variance": Port("mN^2", 2, initial=(0.0, 0.0), description="Its variance."),
        }

    def outputs(self, clock: Clock) -> dict[str, Port]:
        """What the contact was, and by how much more than expected; nothing in the first period."""
        return {
            "contact": Port("mN", 2, description="Force that the contact added in the period before."),
            "mean_error": Port("mN", 2, description="That without the mean expected."),
            "variance_error": Port("mN^2", 2, description="Its square without the variance expected."),
        }
