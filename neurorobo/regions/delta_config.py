"""The configurations of a pair of regions that sends changes only."""

from typing import ClassVar, Literal

from pydantic import Field, ValidationInfo, field_validator

from neurorobo.clock import Clock
from neurorobo.codes.population_signed import PopulationSigned
from neurorobo.regions.config import RegionConfig
from neurorobo.regions.feedforward_config import Quantity
from neurorobo.regions.port import Port
from neurorobo.units import KnownUnit, format_quantity, parse_quantity


class _DeltaConfig(RegionConfig):
    accumulates: ClassVar[bool] = True

    carry: Literal["always"] = "always"
    unit: KnownUnit = Field(description="The unit of the quantity.")
    width: int = Field(default=1, ge=1, description="The number of components.")


class DeltaEncoderConfig(_DeltaConfig):
    """Says in ON and OFF spikes how a quantity changes, one for each ``threshold``; silent while it stays."""

    implementation: ClassVar[str] = "neurorobo.regions.delta:DeltaEncoder"

    type: Literal["delta_encoder"] = "delta_encoder"
    threshold: Quantity = Field(description="The change that one spike stands for, such as 0.5 mN; the resolution.")

    @field_validator("threshold")
    @classmethod
    def _above_zero(cls, text: str, info: ValidationInfo) -> str:
        if (unit := info.data.get("unit")) is None:
            return text
        if (threshold := parse_quantity(text, unit)) <= 0:
            raise ValueError(f"a threshold is above zero (got '{text}')")
        return format_quantity(threshold, unit)

    def inputs(self, clock: Clock) -> dict[str, Port]:
        """Return the quantity."""
        return {"value": Port(self.unit, self.width)}

    def outputs(self, clock: Clock) -> dict[str, Port]:
        """Return its change since the last spike: of each component an ON and an OFF neuron, a spike a threshold."""
        most = parse_quantity(self.threshold, self.unit) * clock.window
        told = "ON and OFF spikes, one for each threshold of change."
        return {"change": Port(self.unit, self.width, PopulationSigned(2, -most, most), description=told)}


class DeltaDecoderConfig(_DeltaConfig):
    """Adds up the changes that a `delta_encoder` sends; it begins at zero, as that does."""

    implementation: ClassVar[str] = "neurorobo.regions.delta:DeltaDecoder"

    type: Literal["delta_decoder"] = "delta_decoder"

    def inputs(self, clock: Clock) -> dict[str, Port]:
        """Return the change, which the edge decodes: no threshold has to be told twice."""
        return {"change": Port(self.unit, self.width, initial=(0.0,) * self.width, once=True)}

    def outputs(self, clock: Clock) -> dict[str, Port]:
        """Return the quantity."""
        return {"value": Port(self.unit, self.width)}
