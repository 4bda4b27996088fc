"""The configuration of a network of plain numbers."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from neurorobo.clock import Clock
from neurorobo.regions.config import RegionConfig
from neurorobo.regions.port import Port
from neurorobo.regions.ranged_port import RangedPort


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
