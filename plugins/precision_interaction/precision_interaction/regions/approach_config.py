"""The configuration of the knowledge of the gap; imports no torch."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from neurorobo.clock import Clock
from neurorobo.regions import Port, RegionConfig
from neurorobo.units import Unit
from precision_interaction import table_one


class ApproachConfig(RegionConfig):
    """Knows the gap: passes the speed on, or 0 while the coming period ends inside the gap."""

    implementation: ClassVar[str] = "precision_interaction.regions.approach:Approach"

    type: Literal["precision.approach"] = "precision.approach"
    period: str = Field(default="radial", description="Name of the period whose contact is expected, as under `time`.")
    length: Annotated[float, Unit("um", gt=0)] = Field(
        default=table_one.LENGTH_UM, description="l: the axial travel, the gap included."
    )
    gap: Annotated[float, Unit("um", ge=0)] = Field(
        default=table_one.GAP_UM, description="Axial travel before contact."
    )

    def inputs(self, clock: Clock) -> dict[str, Port]:
        """Planned axial speed and the distance left."""
        clock.seconds(self.period)  # a ConfigError if there is none of that name
        return {"speed": Port("um/s"), "remaining": Port("um")}

    def outputs(self, clock: Clock) -> dict[str, Port]:
        """The speed at which contact is to be expected."""
        return {"speed": Port("um/s")}
