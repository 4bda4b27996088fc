"""The configuration of a spiking network that says numbers."""

from collections.abc import Mapping
from typing import Any, ClassVar, Literal, Self

from pydantic import Field, model_validator

from neurorobo.clock import Clock
from neurorobo.errors import did_you_mean
from neurorobo.regions.port import Port
from neurorobo.regions.ranged_port import RangedPort
from neurorobo.regions.spiking_network_config import LayeredNetworkConfig, Name

Reading = Literal["rate", "last", "mean", "largest"]


class ReadoutConfig(RangedPort):
    """A quantity that is read out of layers as a number."""

    range: str = Field(description="The values that can be said, such as 0..100 um/s; what goes beyond saturates.")
    reads: tuple[str, ...] = Field(min_length=1, description="The layers that are weighed, all to all.")
    takes: Reading = Field(
        default="rate",
        description="The weighted sum of firing rates, or the last, mean or largest potential of a neuron that does "
        "not fire.",
    )
    decay: float | None = Field(
        default=None, ge=0, lt=1, description="What is left of that potential after one step; not of a rate."
    )

    @model_validator(mode="after")
    def _potentials_decay(self) -> Self:
        if self.takes == "rate" and self.decay is not None:
            raise ValueError("a rate has no `decay`; leave it out, or take the `last`, `mean` or `largest` potential")
        if self.takes != "rate" and self.decay is None:
            raise ValueError(f"the {self.takes} potential needs a `decay`, such as 0.9, what is left after one step")
        return self


class ReadoutNetworkConfig(LayeredNetworkConfig):
    """Layers by name, as of a `spiking_network`, and read-outs that weigh their spikes; all of it learns together.

    Weights are those of layers and read-outs alone: they fit whatever the units and ranges of the ports are.
    """

    implementation: ClassVar[str] = "neurorobo.regions.readout_network:ReadoutNetwork"

    type: Literal["readout_network"] = "readout_network"
    sends: dict[Name, ReadoutConfig] = Field(alias="outputs", min_length=1, description="The outputs, by name.")

    @model_validator(mode="after")
    def _layers_are_read(self) -> Self:
        for name, readout in self.sends.items():
            if name in self.layers:
                raise ValueError(f"an output and a layer are both called `{name}`; call one of them otherwise")
            for read in readout.reads:
                if read not in self.layers:
                    raise ValueError(
                        f"the output `{name}` reads `{read}`, which is no layer{did_you_mean(read, self.layers)}"
                    )
        return self

    def outputs(self, clock: Clock) -> dict[str, Port]:
        """Return what it says, as numbers."""
        return {name: Port(readout.unit, readout.width) for name, readout in self.sends.items()}

    def signature(self, clock: Clock) -> Mapping[str, Any]:
        """Return what weights depend on: the layers, how many channels they read, and how they are read out."""
        readouts = {name: each.model_dump(mode="json", exclude={"unit", "range"}) for name, each in self.sends.items()}
        return {**super().signature(clock), "outputs": readouts}
