"""The configuration of a network of plain numbers."""

from typing import Annotated, ClassVar, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from neurorobo.clock import Clock
from neurorobo.regions.config import RegionConfig
from neurorobo.regions.port import Port
from neurorobo.units import Interval, parse_interval


class RangedPort(BaseModel):
    """A quantity that goes in or comes out as numbers."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    unit: str = Field(description="The unit of the quantity, such as um/s.")
    width: int = Field(default=1, ge=1, description="The number of components.")
    range: str = Field(description="What the network computes with as -1..1, such as 0..100 um/s.")

    @model_validator(mode="after")
    def _in_unit(self) -> Self:
        parse_interval(self.range, self.unit)
        return self

    @property
    def interval(self) -> Interval:
        """The range, in the unit of the port."""
        return parse_interval(self.range, self.unit)


class DenseNetworkConfig(RegionConfig):
    """Layers of units without spikes, all to all: what a spiking network is to be compared with."""

    implementation: ClassVar[str] = "neurorobo.regions.dense_network:DenseNetwork"

    type: Literal["dense_network"] = "dense_network"
    receives: dict[str, RangedPort] = Field(alias="inputs", min_length=1, description="The inputs, by name.")
    sends: dict[str, RangedPort] = Field(alias="outputs", min_length=1, description="The outputs, by name.")
    hidden: tuple[Annotated[int, Field(ge=1)], ...] = Field(
        default=(100,), description="The units of each layer between inputs and outputs."
    )

    def inputs(self, clock: Clock) -> dict[str, Port]:
        """Return what it receives."""
        return {name: Port(port.unit, port.width) for name, port in self.receives.items()}

    def outputs(self, clock: Clock) -> dict[str, Port]:
        """Return what it sends."""
        return {name: Port(port.unit, port.width) for name, port in self.sends.items()}
