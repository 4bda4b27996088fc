"""The configuration of a read-out that learns while it runs; imports no torch."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from neurorobo.clock import Clock
from neurorobo.regions.config import RegionConfig
from neurorobo.regions.feedforward_config import CodedPort
from neurorobo.regions.port import Port
from neurorobo.regions.ranged_port import RangedPort
from neurorobo.units import Duration


class LeastSquaresReadoutConfig(RegionConfig):
    """Says a quantity as a weighted sum of filtered spikes, and learns the weights from each error that it is told.

    They are, at any time, those of ridge regression on all that it was told so far.
    """

    implementation: ClassVar[str] = "neurorobo_paradigms.path_memory.readout:LeastSquaresReadout"
    accumulates: ClassVar[bool] = True

    type: Literal["paradigms.least_squares_readout"] = "paradigms.least_squares_readout"
    carry: Literal["always"] = Field(default="always", description="How long the state lives: always, as it learns.")
    receives: dict[str, CodedPort] = Field(alias="inputs", min_length=1, description="The spikes it reads, by name.")
    says: RangedPort = Field(alias="output", description="The quantity that it says, as the output `said`.")
    filter: Annotated[Duration, Field(gt=0)] = Field(
        default=50_000_000, description="The time constant with which spikes are filtered."
    )
    ridge: float = Field(
        default=0.01, gt=0, description="The price of large weights; the larger, the slower it learns."
    )

    def inputs(self, clock: Clock) -> dict[str, Port]:
        """Return the spikes, and the error of what was said last."""
        spikes = {name: port.port() for name, port in self.receives.items()}
        nothing = (0.0,) * self.says.width
        told = "What should have been said, less what was; exactly 0 where nothing is to be learned."
        return {**spikes, "error": Port(self.says.unit, self.says.width, initial=nothing, description=told)}

    def outputs(self, clock: Clock) -> dict[str, Port]:
        """Return what is said."""
        return {"said": Port(self.says.unit, self.says.width)}
