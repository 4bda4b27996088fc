"""Gaussian receptive fields: each neuron answers to its own part of the range."""

import math
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

from neurorobo.codes.code import Code

if TYPE_CHECKING:
    import torch
    from torch import Tensor

MARGIN = 2
"""Centres beyond each end of the range: without them the fields would weigh its ends too far inside."""

LEAST_NEURONS = 2 * MARGIN + 2

WIDTH = 0.75
"""Of a field, its standard deviation in distances of centres: wide enough that all fields together weigh evenly."""

PLACES = 64
"""Values at which the largest error is sought between two centres."""


@dataclass(frozen=True)
class GaussianReceptiveFields(Code):
    """Neurons with evenly spaced centres; each fires the more, the nearer the value is to its centre.

    The activation of a neuron with centre c is ``A = exp(-(value - c)**2 / (2 width**2))``. It accumulates from one
    half on and fires when a whole is passed, so after t steps it has fired ``floor(t A + 1/2)`` times; deterministic.
    The centres' mean, weighted by the spikes, is the decoded value: differentiable, and never beyond the outermost
    centre. Source: the population encoder of Tang et al. 2020 (PopSAN), with fixed fields, its deterministic spikes.
    """

    def __post_init__(self) -> None:
        """Refuse too few neurons to have a centre at each end and two beyond it."""
        super().__post_init__()
        if self.neurons < LEAST_NEURONS:
            raise ValueError(f"receptive fields need {LEAST_NEURONS} neurons or more (got {self.neurons})")

    @property
    def spacing(self) -> float:
        """The distance of neighbouring centres."""
        return (self.hi - self.lo) / (self.neurons - 1 - 2 * MARGIN)

    def resolution(self, steps: int) -> float:
        """Return twice the largest error of encoding and decoding again: what is further apart is told apart.

        A bound: each neuron is taken to be rounded by the worst half a spike, or by all that it has.
        """
        return 2 * _largest_error(self.neurons, steps) * self.spacing

    def encode(self, values: "Tensor", steps: int, generator: "torch.Generator | None" = None) -> "Tensor":
        """Return the spikes of ``values``; deterministic."""
        import torch

        place = self.fraction(values) * (self.neurons - 1 - 2 * MARGIN) + MARGIN  # in spacings from the first centre
        distance = place.unsqueeze(-1) - torch.arange(self.neurons, dtype=values.dtype, device=values.device)
        activation = (-0.5 * (distance / WIDTH).square()).exp()
        time = torch.arange(steps + 1, dtype=values.dtype, device=values.device).view(-1, 1, 1, 1)
        return (time * activation + 0.5).floor().diff(dim=0).flatten(2)

    def decode(self, spikes: "Tensor") -> "Tensor":
        """Return the mean of the centres, weighted by their spikes; the middle of the range if none has fired."""
        import torch

        counts = spikes.sum(0).unflatten(-1, (-1, self.neurons))
        index = torch.arange(self.neurons, dtype=spikes.dtype, device=spikes.device)
        total = counts.sum(-1)
        middle = (self.neurons - 1) / 2
        place = torch.where(total > 0, (counts * index).sum(-1) / total.clamp(min=1), middle)
        return self.lo + (place - MARGIN) * self.spacing


@cache
def _largest_error(neurons: int, steps: int) -> float:
    """Return the bound of the decoding error over the range, in distances of centres."""
    worst = 0.0
    last = neurons - 1 - 2 * MARGIN
    for place in (MARGIN + min(i / PLACES, last) for i in range(PLACES + 1)):
        distances = [centre - place for centre in range(neurons)]
        counts = [steps * math.exp(-0.5 * (distance / WIDTH) ** 2) for distance in distances]
        lost = [min(0.5, count) for count in counts]
        moment = abs(sum(distance * count for distance, count in zip(distances, counts, strict=True)))
        moment += sum(abs(distance) * loss for distance, loss in zip(distances, lost, strict=True))
        worst = max(worst, moment / (sum(counts) - sum(lost)) if sum(counts) > sum(lost) else math.inf)
    return worst
