"""Whether two libraries give the same spikes, and if not, whether the first difference is one of rounding.

After a first difference all that follows may differ. So what counts is the first one of each run: up to there both had
the same spikes, and the potential of the neuron in question is known. If it is within `ROUNDING` of the threshold, two
libraries that add in another order may well disagree.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from neurorobo.engine import Circuit, Layer
from neurorobo.neurons import LIF

ROUNDING = 1e-5
"""How far from the threshold a potential may be where libraries disagree."""


@dataclass(frozen=True)
class Agreement:
    """Of so many spike trains' steps, how many differ, and the distance to the threshold at each run's first one."""

    steps: int
    different: int
    first_distances: tuple[float, ...]

    @property
    def holds(self) -> bool:
        """Whether all spikes are the same, or every first difference is one of rounding."""
        return all(distance < ROUNDING for distance in self.first_distances)

    def __str__(self) -> str:
        """Return both in words."""
        if not self.different:
            return f"same spikes ({self.steps} neuron steps)"
        runs, farthest = len(self.first_distances), max(self.first_distances)
        return f"{self.different} of {self.steps} neuron steps differ, in {runs} runs; first within {farthest:.1e}"


def agreement(
    circuit: Circuit, inputs: Mapping[str, Tensor], ours: Mapping[str, Tensor], theirs: Mapping[str, Tensor]
) -> Agreement:
    """Compare the spikes (steps, batch, neurons) of every layer that both name; ``ours`` are all, run from rest."""
    names = [name for name in circuit.layers if name in theirs]
    if not names or set(theirs) - set(circuit.layers):
        raise ValueError(f"layers {sorted(circuit.layers)} cannot be compared with {sorted(theirs)}")
    known = {**inputs, **ours}
    different = {name: ours[name] != theirs[name] for name in names}
    distances = []
    for run in range(next(iter(ours.values())).shape[1]):
        first: tuple[int, float] | None = None
        for name in names:  # in their order, within a step as well
            where = different[name][:, run].nonzero()
            if len(where) and (first is None or int(where[0, 0]) < first[0]):
                step = int(where[0, 0])
                layer = circuit.layers[name]
                potential = _potential(layer, circuit.readings[name], known, ours[name], run, step)
                neurons = where[where[:, 0] == step, 1]
                thresholds = _thresholds(layer).double()
                first = step, float((potential - thresholds)[neurons].abs().max())
        if first is not None:
            distances.append(first[1])
    return Agreement(
        sum(each.numel() for each in different.values()),
        sum(int(each.sum()) for each in different.values()),
        tuple(distances),
    )


@torch.no_grad()
def _potential(
    layer: Layer, readings: list[tuple[str, ...]], known: Mapping[str, Tensor], fired: Tensor, run: int, step: int
) -> Tensor:
    """Return the potentials (neurons) of a run at a step, in double precision."""
    neuron = layer.neuron
    assert isinstance(neuron, LIF)
    assert not neuron.rectify
    potential = torch.zeros(layer.neurons, dtype=torch.float64)
    for now in range(step + 1):
        before = fired[now - 1, run].double() if now else torch.zeros(layer.neurons, dtype=torch.float64)
        potential = neuron.decay * potential * (1 - before)
        for projection, group in zip(layer.projections, readings, strict=True):
            spikes = torch.cat([known[name][now, run] for name in group]).double()
            potential = potential + projection.matrix().double() @ spikes  # type: ignore[operator]
        if layer.recurrent is not None:
            potential = potential + layer.recurrent.weight.double() @ before
    return potential


def _thresholds(layer: Layer) -> Tensor:
    if layer.threshold is not None:
        return layer.threshold.detach()
    assert isinstance(layer.neuron, LIF)
    return torch.full((layer.neurons,), layer.neuron.threshold)
