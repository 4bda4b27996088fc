"""The networks that the engine is measured on: the sizes of the three brain regions, with random weights and spikes.

All weights are multiples of 2**-12, so that sums of them are exact in any order: an implementation that solves the same
equations, with the same rounding of the decay, gives the same spikes to the last one.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import torch
from torch import Tensor

from neurorobo.regions.weights import to_grid

STEPS = 50
INPUT_RATE, HIDDEN_RATE = 0.3, 0.2

Inputs = Literal["random", "shipped"]


@dataclass(frozen=True)
class Population:
    """LIF neurons, what they read side by side, and their weights.

    ``reads`` counts the inputs of the network first and then its populations. ``weight`` is (neurons, sources), or
    (neurons, fan_in) with the sources' ``index`` of the same shape; ``recurrent`` is (neurons, neurons). ``threshold``
    is one number or (neurons). Potentials of neurons that ``rectify`` are at least zero.
    """

    reads: tuple[int, ...]
    weight: Tensor
    index: Tensor | None = None
    recurrent: Tensor | None = None
    threshold: float | Tensor = 0.5
    decay: float = 0.2
    rectify: bool = False

    @property
    def neurons(self) -> int:
        """Return the number of neurons."""
        return len(self.weight)

    def matrix(self, sources: int) -> Tensor:
        """Return the weights (neurons, sources) in full."""
        if self.index is None:
            return self.weight
        return self.weight.new_zeros(self.neurons, sources).scatter(1, self.index, self.weight)


@dataclass(frozen=True)
class Network:
    """Inputs of some sizes and populations in order, of which the last one is the output; batch 64 or less in training.

    ``windows`` are spikes (steps, windows, neurons) of each input to draw from; without them, they are random.
    """

    name: str
    inputs: Inputs
    sizes: tuple[int, ...]
    populations: Sequence[Population]
    training_batch: int
    windows: Sequence[Tensor] = ()

    def sources(self, population: Population) -> list[int]:
        """Return the sizes of what a population reads."""
        known = [*self.sizes, *(population.neurons for population in self.populations)]
        return [known[read] for read in population.reads]

    def weights(self) -> list[Tensor]:
        """Return all weights, a recurrent matrix behind those that it belongs to."""
        both = ((population.weight, population.recurrent) for population in self.populations)
        return [weight for pair in both for weight in pair if weight is not None]

    def draw(self, batch: int, generator: torch.Generator) -> list[Tensor]:
        """Return spikes (steps, batch, neurons) of each input: random ones, or a draw of the windows that there are."""
        if not self.windows:
            return [(torch.rand(STEPS, batch, n, generator=generator) < INPUT_RATE).float() for n in self.sizes]
        there_are = self.windows[0].shape[1]
        if batch > there_are:
            raise ValueError(f"{self.name} was recorded in {there_are} windows, too few for a batch of {batch}")
        chosen = torch.randperm(there_are, generator=generator)[:batch]
        return [spikes[:, chosen].float() for spikes in self.windows]


def run(network: Network, inputs: Sequence[Tensor]) -> list[Tensor]:
    """Return the spikes of all populations by the plain equations, from rest."""
    known = list(inputs)
    for population in network.populations:
        known.append(_run(population, torch.cat([known[read] for read in population.reads], dim=-1)))
    return known[len(inputs) :]


def _run(population: Population, spikes: Tensor) -> Tensor:
    potential = fired = spikes.new_zeros(spikes.shape[1], population.neurons)
    rows = []
    for current in spikes @ population.matrix(spikes.shape[-1]).t():
        if population.recurrent is not None:
            current = current + fired @ population.recurrent.t()
        potential = current + population.decay * (potential * (1 - fired))
        if population.rectify:
            potential = potential.relu()
        fired = (potential >= population.threshold).float()
        rows.append(fired)
    return torch.stack(rows)


def random_networks(scale: float = 1.0) -> list[Network]:
    """Return the three networks, with layers of ``scale`` their size.

    H: 50 inputs, 343 recurrent neurons, 40 outputs. P: 64 inputs, 256, 512, 512, 128 neurons, 4 outputs. C: 64 inputs,
    4000 neurons that read 4 of them each, 1600 neurons, 8 outputs.
    """

    def sizes(*full: int) -> list[int]:
        return [max(4, round(scale * size)) for size in full]

    generator = torch.Generator().manual_seed(0)
    return [
        _chain("H", sizes(50, 343, 40), 64, generator, recurrent=True),
        _chain("P", sizes(64, 256, 512, 512, 128, 4), 64, generator),
        _chain("C", sizes(64, 4000, 1600, 8), 16, generator, fan_in=4),
    ]


def _chain(
    name: str,
    sizes: list[int],
    training_batch: int,
    generator: torch.Generator,
    *,
    fan_in: int | None = None,
    recurrent: bool = False,
) -> Network:
    """Return layer behind layer; the first may have a fan-in or be recurrent. Each fires at about `HIDDEN_RATE`."""
    network = Network(name, "random", (sizes[0],), (), training_batch)
    (spikes,) = network.draw(16, generator)
    for number, (sources, neurons) in enumerate(pairwise(sizes)):
        index = own = None
        read = sources
        if number == 0 and fan_in is not None:
            index, read = torch.rand(neurons, sources, generator=generator).argsort(1)[:, :fan_in].contiguous(), fan_in
        weight = torch.randn(neurons, read, generator=generator) / read**0.5
        if number == 0 and recurrent:
            own = torch.randn(neurons, neurons, generator=generator) / neurons**0.5
        population, spikes = _scaled(Population((number,), weight, index, own), spikes)
        network = replace(network, populations=(*network.populations, population))
    return network


def _scaled(population: Population, spikes: Tensor) -> tuple[Population, Tensor]:
    """Return the population with its weights scaled to `HIDDEN_RATE` by bisection, and its spikes."""
    low, high = 0.0, 64.0
    for _ in range(16):
        gain = (low + high) / 2
        recurrent = None if population.recurrent is None else to_grid(population.recurrent * gain, 12)
        scaled = replace(population, weight=to_grid(population.weight * gain, 12), recurrent=recurrent)
        fired = _run(scaled, spikes)
        low, high = (gain, high) if fired.mean() < HIDDEN_RATE else (low, gain)
    return scaled, fired
