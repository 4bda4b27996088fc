"""The configuration of a liquid; imports no torch."""

from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from neurorobo.clock import Clock
from neurorobo.codes import PopulationUniform
from neurorobo.regions.config import RegionConfig
from neurorobo.regions.feedforward_config import CodedPort
from neurorobo.regions.port import Port
from neurorobo.units import Duration


class LiquidConfig(RegionConfig):
    """A random recurrent network of spiking neurons, whose state tells what it hears and has heard; nothing is learned.

    Strengths are in units of the threshold.
    """

    implementation: ClassVar[str] = "neurorobo_paradigms.path_memory.liquid:Liquid"

    type: Literal["paradigms.liquid"] = "paradigms.liquid"
    carry: Literal["always"] = Field(default="always", description="How long the state lives: always, as it is memory.")
    receives: dict[str, CodedPort] = Field(alias="inputs", min_length=1, description="The inputs, by name.")
    neurons: int = Field(default=400, ge=1, description="The number of neurons.")
    inhibitory: float = Field(default=0.2, ge=0, le=1, description="The share of the neurons that inhibit.")
    input_fan_in: int = Field(default=4, ge=1, description="How many channels of the inputs each neuron hears.")
    fan_in: int = Field(default=40, ge=1, description="How many neurons each neuron hears.")
    input_strength: float = Field(
        default=2.0, ge=0, description="Weights of inputs: the scale of their half-normal draw, times sqrt(fan-in)."
    )
    recurrent_strength: float = Field(
        default=0.6, ge=0, description="Excitatory weights among neurons, likewise; at 0 there is no recurrence."
    )
    inhibition: float = Field(
        default=12.0, ge=0, description="Inhibitory weights among neurons, in multiples of the excitatory ones."
    )
    membrane: Annotated[Duration, Field(gt=0)] = Field(
        default=50_000_000, description="The time constant of the membranes."
    )
    synapses: Annotated[Duration, Field(gt=0)] = Field(
        default=300_000_000, description="The time constant of the currents among neurons."
    )

    @model_validator(mode="after")
    def _fan_ins_can_be(self) -> Self:
        channels = sum(port.port().channels for port in self.receives.values())
        for name, fan_in, sources in (
            ("input_fan_in", self.input_fan_in, channels),
            ("fan_in", self.fan_in, self.neurons),
        ):
            if fan_in > sources:
                raise ValueError(f"`{name}` is {fan_in}, and there are {sources} sources; take no more")
        return self

    def inputs(self, clock: Clock) -> dict[str, Port]:
        """Return what it receives."""
        return {name: port.port() for name, port in self.receives.items()}

    def outputs(self, clock: Clock) -> dict[str, Port]:
        """Return the spikes of all neurons; as a number, their mean rate in spikes per neuron and step."""
        code = PopulationUniform(self.neurons, 0.0, 1.0)
        return {"spikes": Port("1", 1, code, description="The spikes of all neurons.")}
