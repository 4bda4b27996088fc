"""The iterative leaky integrate-and-fire neuron."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from neurorobo.neurons.surrogate import Surrogate

if TYPE_CHECKING:
    from torch import Tensor


@dataclass(frozen=True)
class LIF:
    """Iterative leaky integrate-and-fire neuron: ``U[t] = decay * U[t-1] * (1 - S[t-1]) + I[t]``.

    It spikes where ``S[t] = [U[t] >= threshold]`` is 1. The spike resets the carried potential to zero; the new input
    is added after the reset. Potentials are dimensionless, one step is one ``spike_step`` of the clock. Source: Eq. 5-7
    of Xing et al.; the iterative model is from Wu et al. 2018 (STBP).

    ``reset_gradient`` says whether the gradient also flows through the reset (``full``, as autograd would) or not
    (``detached``).
    """

    threshold: float = 0.5
    decay: float = 0.2
    surrogate: Surrogate = Surrogate()
    reset_gradient: Literal["full", "detached"] = "full"
    rectify: bool = False

    def __post_init__(self) -> None:
        """Refuse a decay outside [0, 1], a threshold at which a resting neuron would fire, and an unknown gradient."""
        if not 0 <= self.decay <= 1:
            raise ValueError(f"the decay of a neuron lies in 0..1, got {self.decay}")
        if not 0 < self.threshold < math.inf:
            raise ValueError(
                f"the threshold must be positive, or a neuron fires at rest, and finite, got {self.threshold}"
            )
        if self.reset_gradient not in ("full", "detached"):
            raise ValueError(f"the gradient of the reset is `full` or `detached`, not {self.reset_gradient!r}")

    def at_rest(self, batch: int, neurons: int) -> "Tensor":
        """Return the resting potentials (batch, neurons)."""
        import torch

        return torch.zeros(batch, neurons)

    def step(self, current: "Tensor", potential: "Tensor") -> "tuple[Tensor, Tensor]":
        """Advance one step: ``(current, previous potential) -> (spikes 0/1, potential)``, any shape.

        Layers run whole windows at once instead, see :func:`neurorobo.engine.run_window`.
        """
        fired = self.surrogate.fire(potential - self.threshold)
        if self.reset_gradient == "detached":
            fired = fired.detach()
        potential = current + self.decay * potential * (1 - fired)
        if self.rectify:
            potential = potential.relu()
        return self.surrogate.fire(potential - self.threshold), potential


def spiking_neural_unit(
    threshold: float = 0.5,
    decay: float = 0.2,
    surrogate: Surrogate = Surrogate(),
) -> LIF:
    """Return a spiking neural unit, the LIF whose potential is rectified.

    ``U[t] = max(0, I[t] + decay * U[t-1] * (1 - S[t-1]))``. Source: Wozniak et al. 2020, with ``g`` = ReLU and a step
    output; the unit's bias is the negative threshold, and a layer can train it per neuron
    (``Layer(..., trainable_threshold=True)``).
    """
    return LIF(threshold=threshold, decay=decay, surrogate=surrogate, rectify=True)


def just_above(threshold: float) -> float:
    """Return the next larger threshold of single precision: who fires at it, fires above the given one and not at it.

    No number of single precision lies between the two, so that this is exact for layers of that precision.
    """
    import numpy

    return float(numpy.nextafter(numpy.float32(threshold), numpy.float32(math.inf)))
