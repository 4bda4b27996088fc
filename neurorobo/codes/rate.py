"""Codes that count spikes: population uniform, population nested and Poisson."""

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

from neurorobo.codes.code import Code, by_component

if TYPE_CHECKING:
    import torch
    from torch import Tensor


@dataclass(frozen=True)
class CountCode(Code):
    """A code whose value is the spike count: ``lo + count * resolution``.

    The resolution is ``(hi - lo) / (neurons * steps)``. Source of the decoder: rate decoding, Sec. IV-A of Xing et al.
    """

    def resolution(self, steps: int) -> float:
        """Return the value of one spike."""
        return (self.hi - self.lo) / (self.neurons * steps)

    def may_saturate(self, values: "Tensor") -> bool:
        """Compare in fewer operations; a value next to the end of the range may seem to be outside."""
        if values.numel() <= 16:  # one number after the other takes less time than one operation of torch
            return any(not self.lo <= value <= self.hi for value in values.flatten().tolist())
        least, largest = values.aminmax()
        return float(least) < self.lo or float(largest) > self.hi

    def decode(self, spikes: "Tensor") -> "Tensor":
        """Count the spikes of each component; differentiable."""
        counts = by_component(spikes.sum(0), self.neurons).sum(-1)
        return self.lo + counts * self.resolution(len(spikes))


@dataclass(frozen=True)
class PopulationUniform(CountCode):
    """The nearest number of spikes, spread evenly over neurons and steps.

    A value becomes ``k = round((value - lo) / resolution)`` spikes. After t of T steps neuron n of N has fired
    ``floor(k t / (N T) + n / N)`` times: each at even intervals, and all together ``floor(k t / T)`` times (Hermite's
    identity), so that spikes are spread evenly over neurons and steps and never come in volleys. Encoding and decoding
    again is off by at most half a resolution. Source: population uniform encoding, Sec. IV-A of Xing et al.
    """

    def encode(self, values: "Tensor", steps: int, generator: "torch.Generator | None" = None) -> "Tensor":
        """Return the spikes of ``values``; deterministic."""
        import torch

        slots = self.neurons * steps
        whole = torch.float32 if slots * (steps + 1) < 2**24 else torch.int64  # floats are faster, while they are exact
        count = (self.fraction(values) * slots).round().to(whole).unsqueeze(-1)
        time, shift = (table.to(values.device) for table in _staggered(self.neurons, steps, whole))
        fires = (time * count + shift).remainder_(slots) < count  # where the next whole number is passed
        return fires.to(values.dtype).flatten(2)


@cache
def _staggered(neurons: int, steps: int, dtype: "torch.dtype") -> "tuple[Tensor, Tensor]":
    """Return t = 1, 2, ... (steps, 1, 1, 1) and n T of each neuron (neurons)."""
    import torch

    with torch.inference_mode(False):
        return torch.arange(1, steps + 1, dtype=dtype)[:, None, None, None], steps * torch.arange(neurons, dtype=dtype)


@dataclass(frozen=True)
class PopulationNested(CountCode):
    """The nearest number of spikes, nested: the next larger value has the same spikes and one more.

    A value becomes ``k = round((value - lo) / resolution)`` spikes, shared by the neurons as evenly as can be. Each
    neuron takes its steps in an order that leaves no large gap anywhere, that of van der Corput, begun at a place of
    its own. So a small change of the value is a small change of the spikes, and fewer steps are alike: what reads
    them meets many sums of weights, where evenly spaced spikes repeat a few. Encoding and decoding again is off
    by at most half a resolution.
    """

    def encode(self, values: "Tensor", steps: int, generator: "torch.Generator | None" = None) -> "Tensor":
        """Return the spikes of ``values``; deterministic."""
        count = (self.fraction(values) * (self.neurons * steps)).round().long().unsqueeze(-1)
        first = nested_firsts(self.neurons, steps).to(values.device)
        return (count >= first).to(values.dtype).flatten(2)


@cache
def nested_firsts(neurons: int, steps: int) -> "Tensor":
    """Return from which count on a nested code has each spike, (steps, 1, 1, neurons)."""
    import torch

    bits = (steps - 1).bit_length()
    backwards = [int(format(step, f"0{bits}b")[::-1], 2) for step in range(steps)]
    place = [sorted(backwards).index(value) for value in backwards]  # van der Corput's order
    firsts = [
        [neurons * ((place[step] + neuron * steps // neurons) % steps + 1) - neuron for neuron in range(neurons)]
        for step in range(steps)
    ]
    with torch.inference_mode(False):
        return torch.tensor(firsts)[:, None, None]


@dataclass(frozen=True)
class Poisson(CountCode):
    """Independent spikes with the probability of the value's place in the range.

    The decoded value is unbiased; its variance is ``neurons * steps * p * (1 - p) * resolution**2``.
    """

    @property
    def stochastic(self) -> bool:
        """A Poisson code draws every spike."""
        return True

    def encode(self, values: "Tensor", steps: int, generator: "torch.Generator | None" = None) -> "Tensor":
        """Draw the spikes of ``values`` from ``generator``, which must be given."""
        import torch

        if generator is None:
            raise ValueError("a Poisson code needs a random generator")
        probability = self.fraction(values).repeat_interleave(self.neurons, dim=1)
        shape = (steps, *probability.shape)
        uniform = torch.rand(shape, generator=generator, dtype=values.dtype, device=generator.device)
        return (uniform.to(values.device) < probability).to(values.dtype)
