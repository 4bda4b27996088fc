"""The soft spiking neural unit, which sends numbers in place of spikes."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from neurorobo.neurons.exponential import sigmoid

if TYPE_CHECKING:
    from torch import Tensor


@dataclass(frozen=True)
class SoftUnit:
    """The soft spiking neural unit: a rectified integrator whose output is a sigmoid, and resets it by as much.

    ``U[t] = max(0, I[t] + decay U[t-1] (1 - Y[t-1]))`` and ``Y[t] = 1 / (1 + exp(-slope (U[t] - threshold)))``. The
    state (batch, neurons) is ``U``, from which the last output follows. Its outputs are numbers between 0 and 1, and
    only layers that are told so can read it. Source: Wozniak et al. 2020, with ``g`` = ReLU and ``h`` = sigmoid; the
    unit's bias is the negative threshold.
    """

    threshold: float = 0.5
    decay: float = 0.2
    slope: float = 1.0

    def __post_init__(self) -> None:
        """Refuse a decay outside [0, 1], and numbers that are not finite."""
        if not 0 <= self.decay <= 1:
            raise ValueError(f"the decay of a unit lies in 0..1, got {self.decay}")
        if not math.isfinite(self.threshold):
            raise ValueError(f"the threshold is finite, got {self.threshold}")
        if not 0 < self.slope < math.inf:
            raise ValueError(f"the slope is positive and finite, got {self.slope}")

    def at_rest(self, batch: int, neurons: int) -> "Tensor":
        """Return the resting potentials (batch, neurons)."""
        import torch

        return torch.zeros(batch, neurons)

    def output(self, potential: "Tensor") -> "Tensor":
        """Return what a unit sends at a potential, any shape."""
        return sigmoid((potential - self.threshold) * self.slope)

    def step(self, current: "Tensor", state: "Tensor") -> "tuple[Tensor, Tensor]":
        """Advance one step: input (batch, neurons) and potentials -> outputs in 0..1 and the next potentials."""
        potential = (state * self.decay * (1 - self.output(state)) + current).relu()
        return self.output(potential), potential
