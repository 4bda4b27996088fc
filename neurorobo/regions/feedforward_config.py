"""The configuration of the general feed-forward region."""

from typing import Annotated, ClassVar, Literal

from pydantic import BeforeValidator, Field, ValidationInfo, field_validator

from neurorobo.clock import Clock
from neurorobo.codes import CodeConfig
from neurorobo.codes.config import PopulationUniformConfig
from neurorobo.neurons import NeuronConfig
from neurorobo.neurons.config import LIFConfig
from neurorobo.plugged_field import Plugged
from neurorobo.regions.config import RegionConfig
from neurorobo.regions.port import Port
from neurorobo.regions.ranged_port import RangedPort
from neurorobo.units import format_quantity, parse_quantity

Quantity = Annotated[
    str, BeforeValidator(lambda value: str(value) if type(value) in (int, float) else value)
]  # of a unit that another key names, so that it is text


class CodedPort(RangedPort):
    """A quantity that goes in or comes out as spikes."""

    range: str = Field(description="The values that the code can tell apart, such as 0..100 um/s.")
    code: Annotated[CodeConfig, Plugged("code")] = PopulationUniformConfig()
    initial: Quantity | None = Field(
        default=None, description="The value of an input, in all components, before its source has spoken."
    )

    @field_validator("initial")
    @classmethod
    def _quantity(cls, text: str | None, info: ValidationInfo) -> str | None:
        unit = info.data.get("unit")
        return text if text is None or unit is None else format_quantity(parse_quantity(text, unit), unit)

    def port(self) -> Port:
        """Return the port; a ValueError if the code cannot be."""
        interval = self.interval
        initial = None if self.initial is None else (parse_quantity(self.initial, self.unit),) * self.width
        return Port(self.unit, self.width, self.code.build(interval.lo, interval.hi), initial)


class FeedforwardConfig(RegionConfig):
    """Layers of one neuron, all to all, from the spikes of its inputs to those of its outputs."""

    implementation: ClassVar[str] = "neurorobo.regions.feedforward:Feedforward"
    not_in_signature: ClassVar[frozenset[str]] = RegionConfig.not_in_signature | {"gain"}

    type: Literal["feedforward"] = "feedforward"
    receives: dict[str, CodedPort] = Field(alias="inputs", min_length=1, description="The inputs, by name.")
    sends: dict[str, CodedPort] = Field(alias="outputs", min_length=1, description="The outputs, by name.")
    hidden: tuple[Annotated[int, Field(ge=1)], ...] = Field(
        default=(100,), description="The neurons of each layer between inputs and outputs."
    )
    neuron: Annotated[NeuronConfig, Plugged("neuron")] = LIFConfig()
    gain: float = Field(
        default=1.5, gt=0, description="Fresh weights are drawn with the standard deviation gain / sqrt(fan-in)."
    )

    def inputs(self, clock: Clock) -> dict[str, Port]:
        """Return what it receives."""
        return {name: port.port() for name, port in self.receives.items()}

    def outputs(self, clock: Clock) -> dict[str, Port]:
        """Return what it sends."""
        return {name: port.port() for name, port in self.sends.items()}
