"""The configuration of a neuron of snnTorch; imports neither torch nor snnTorch."""

from typing import Annotated, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from neurorobo.neurons.config import NeuronConfig
from neurorobo.neurons.snntorch_neuron import REFUSED, SnnTorchNeuron

Decay = Annotated[float, Field(ge=0, le=1)]


def _not_refused(value: object) -> object:
    if isinstance(value, str) and value in REFUSED:
        raise ValueError(f"{value} cannot be a neuron of a layer: {REFUSED[value]}")
    return value


class SnnTorchNeuronConfig(NeuronConfig):
    """A neuron of snnTorch, by the names of its class and arguments there; it fires above its threshold."""

    type: Literal["snntorch_neuron"] = "snntorch_neuron"
    class_: Annotated[Literal["Leaky", "Lapicque", "Synaptic", "Alpha"], BeforeValidator(_not_refused)] = Field(
        default="Leaky", alias="class", description="The class of snnTorch."
    )
    beta: Decay = Field(description="What is left of the potential after one step.")
    alpha: Decay | None = Field(
        default=None, description="What is left of the synaptic current after one step; of Synaptic and Alpha."
    )
    threshold: float = Field(default=1.0, gt=0)
    reset_mechanism: Literal["subtract", "zero", "none"] | None = Field(
        default=None, description="What a spike does to the potential; snnTorch's default if left out."
    )
    reset_delay: bool = Field(
        default=True, description="Whether it does so in the next step; at once, of Leaky and Synaptic alone."
    )
    spike_grad: Literal["atan", "fast_sigmoid"] = Field(default="atan", description="The surrogate.")
    slope: float | None = Field(
        default=None, gt=0, description="How steep the surrogate is, `alpha` of `atan`; snnTorch's default if left out."
    )

    @model_validator(mode="after")
    def _arguments_of_the_class(self) -> Self:
        takes_alpha = self.class_ in ("Synaptic", "Alpha")
        if takes_alpha != (self.alpha is not None):
            raise ValueError(f"{self.class_} {'needs' if takes_alpha else 'has no'} `alpha`")
        if not self.reset_delay and self.class_ in ("Lapicque", "Alpha"):
            raise ValueError(f"{self.class_} resets in the next step; leave out `reset_delay`")
        return self

    def build(self, step_ns: int) -> SnnTorchNeuron:
        """Return the neuron, the same at every step; a ValueError if snnTorch refuses the values."""
        import snntorch
        from snntorch import surrogate

        named = {name: getattr(self, name) for name in ("alpha", "reset_mechanism") if getattr(self, name) is not None}
        if self.class_ in ("Leaky", "Synaptic"):
            named["reset_delay"] = self.reset_delay
        steepness = () if self.slope is None else (self.slope,)
        spike_grad = getattr(surrogate, self.spike_grad)(*steepness)
        neuron = getattr(snntorch, self.class_)(
            beta=self.beta, threshold=self.threshold, spike_grad=spike_grad, **named
        )
        snntorch.SpikingNeuron.instances.remove(neuron)  # it would stay there for good
        return SnnTorchNeuron(neuron)
