"""The configuration of the summing region."""

from typing import ClassVar, Literal

from pydantic import Field

from neurorobo.clock import Clock
from neurorobo.regions.config import RegionConfig
from neurorobo.regions.port import Port


class SumConfig(RegionConfig):
    """Adds two quantities of one unit: a place in the graph where populations converge."""

    implementation: ClassVar[str] = "neurorobo.regions.sum:Sum"

    type: Literal["sum"] = "sum"
    unit: str = Field(description="The unit of both inputs and of their sum.")
    width: int = Field(default=1, ge=1, description="The number of components.")

    def inputs(self, clock: Clock) -> dict[str, Port]:
        """Return the two terms."""
        return {"a": Port(self.unit, self.width), "b": Port(self.unit, self.width)}

    def outputs(self, clock: Clock) -> dict[str, Port]:
        """Return their sum."""
        return {"sum": Port(self.unit, self.width)}
