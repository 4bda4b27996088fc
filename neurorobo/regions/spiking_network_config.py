"""The configuration of networks that are written down layer by layer."""

from abc import ABC
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from neurorobo.clock import Clock
from neurorobo.errors import did_you_mean
from neurorobo.neurons import NeuronConfig
from neurorobo.neurons.config import LIFConfig
from neurorobo.plugged_field import Plugged
from neurorobo.regions.config import Path, RegionConfig
from neurorobo.regions.feedforward_config import CodedPort
from neurorobo.regions.port import Port

INPUTS = "inputs"
"""What a layer reads that reads all inputs, side by side in their order."""

Name = Annotated[str, Field(pattern=r"^[A-Za-z]\w*$")]


class LayerConfig(BaseModel):
    """A population of neurons and what excites it."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    neurons: int = Field(ge=1)
    reads: tuple[str, ...] = Field(
        min_length=1,
        description="Layers before it, inputs, or `inputs`, which are all inputs side by side; all to all.",
    )
    recurrent: bool = Field(default=False, description="Whether its neurons excite one another, a step later.")
    bias: bool = Field(default=False, description="Whether each neuron has a constant current of its own.")
    own_thresholds: bool = Field(
        default=False, description="Whether each neuron has a threshold of its own, to be trained; of `lif` neurons."
    )
    neuron: Annotated[NeuronConfig, Plugged("neuron")] = LIFConfig()

    @model_validator(mode="after")
    def _thresholds_can_be_trained(self) -> Self:
        if self.own_thresholds and not self.neuron.trains_thresholds:
            raise ValueError(
                f"`own_thresholds` are for `lif` neurons, and those of `{self.neuron.type}` cannot be trained; "
                "leave it out"
            )
        return self


class LayeredNetworkConfig(RegionConfig, ABC):
    """Base of the configurations of networks: layers by name, each of its own neurons and its own sources."""

    receives: dict[Name, CodedPort] = Field(alias="inputs", min_length=1, description="The inputs, by name.")
    layers: dict[Name, LayerConfig] = Field(min_length=1, description="The layers, by name, in order.")
    gain: float = Field(
        default=1.5, gt=0, description="Fresh weights are drawn with the standard deviation gain / sqrt(fan-in)."
    )

    @model_validator(mode="after")
    def _sources_come_first(self) -> Self:
        known: list[str] = [INPUTS, *self.receives]
        for name, layer in self.layers.items():
            if name == INPUTS or name in self.receives:
                raise ValueError(f"no layer can be called `{name}`, as an input is; call it otherwise")
            for read in layer.reads:
                if read == name:
                    raise ValueError(f"the layer `{name}` reads itself; say `recurrent: true` instead")
                if read not in known:
                    raise ValueError(
                        f"the layer `{name}` reads `{read}`, which is neither an input nor a layer before it"
                        f"{did_you_mean(read, known)}"
                    )
            known.append(name)
        return self

    def needs_spikes(self, path: Path) -> bool:
        """Whether the neuron at a path has to send spikes; layers and read-outs can read numbers."""
        return False

    def inputs(self, clock: Clock) -> dict[str, Port]:
        """Return what it receives."""
        return {name: port.port() for name, port in self.receives.items()}

    def signature(self, clock: Clock) -> Mapping[str, Any]:
        """Return what weights depend on: the layers, and how many channels they read."""
        channels = sum(port.channels for port in self.inputs(clock).values())
        layers = {name: layer.model_dump(mode="json") for name, layer in self.layers.items()}
        return {"type": self.type, "inputs": channels, "layers": layers}


class NetworkConfig(LayeredNetworkConfig):
    """Layers by name, each of its own neurons and its own sources; the last one sends the outputs.

    Weights are those of the layers alone: they fit whatever the quantities and codes of the ports are.
    """

    implementation: ClassVar[str] = "neurorobo.regions.spiking_network:Network"

    type: Literal["spiking_network"] = "spiking_network"
    sends: dict[Name, CodedPort] = Field(
        alias="outputs", min_length=1, description="The outputs, by name; side by side, they are the last layer."
    )

    def needs_spikes(self, path: Path) -> bool:
        """Whether the neuron at a path has to send spikes, as that of the last layer has."""
        return path == ("layers", [*self.layers][-1], "neuron")

    def outputs(self, clock: Clock) -> dict[str, Port]:
        """Return what it sends; a ValueError unless the last layer has a neuron for each channel of the outputs."""
        ports = {name: port.port() for name, port in self.sends.items()}
        channels = sum(port.channels for port in ports.values())
        name, layer = list(self.layers.items())[-1]
        if layer.neurons != channels:
            raise ValueError(
                f"the last layer, `{name}`, has {layer.neurons} neurons, the outputs have {channels}; "
                "give both the same number"
            )
        return ports
