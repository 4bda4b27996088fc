"""A plugin that brings a neuron and a code; `docs/how_to/write_a_neuron_or_code.md` shows it."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from pydantic import Field

from neurorobo.codes import CodeConfig, CountCode
from neurorobo.neurons import NeuronConfig, Surrogate
from neurorobo.plugins import Registrar, hookimpl

if TYPE_CHECKING:
    import torch
    from torch import Tensor


# neuron
ARCTAN = Surrogate("arctan")


@dataclass(frozen=True)
class Adaptive:
    """A leaky neuron whose threshold rises with each spike and falls back."""

    rise: float

    def at_rest(self, batch: int, neurons: int) -> "Tensor":
        import torch

        return torch.zeros(batch, 2 * neurons)  # the potential and the rise of each neuron

    def step(self, current: "Tensor", state: "Tensor") -> "tuple[Tensor, Tensor]":
        import torch

        potential, risen = state.chunk(2, dim=1)
        potential = 0.5 * potential + current
        fired = ARCTAN.fire(potential - 0.5 - risen)
        return fired, torch.cat([potential * (1 - fired), 0.9 * risen + self.rise * fired], dim=1)


class AdaptiveConfig(NeuronConfig):
    """What a file says of it: {type: acme.adaptive, rise: 0.2}."""

    type: Literal["acme.adaptive"] = "acme.adaptive"
    rise: float = Field(default=0.1, ge=0, description="What a spike adds to the threshold.")

    def build(self, step_ns: int) -> Adaptive:
        return Adaptive(self.rise)


# code
@dataclass(frozen=True)
class Burst(CountCode):
    """As many spikes as the value asks for, as early as possible; they are counted as in any count code."""

    def encode(self, values: "Tensor", steps: int, generator: "torch.Generator | None" = None) -> "Tensor":
        import torch

        count = (self.fraction(values) * (self.neurons * steps)).round()
        place = torch.arange(steps * self.neurons).view(steps, 1, 1, self.neurons)
        return (place < count.unsqueeze(-1)).to(values.dtype).flatten(2)


class BurstConfig(CodeConfig):
    """What a file says of it: {type: acme.burst, neurons: 4}; the range is the port's."""

    type: Literal["acme.burst"] = "acme.burst"
    neurons: int = Field(default=8, ge=1)

    def build(self, lo: float, hi: float) -> Burst:
        return Burst(self.neurons, lo, hi)


# registration
@hookimpl
def neurorobo_register(registry: Registrar) -> None:
    registry.add("neuron", "acme.adaptive", f"{__name__}:AdaptiveConfig", "its threshold rises with each spike")
    registry.add("code", "acme.burst", f"{__name__}:BurstConfig", "spikes as early as possible")
