"""Leaky integrate-and-fire neurons with what is often added to them: a synaptic current and an adaptive threshold."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from neurorobo.neurons.surrogate import Surrogate

if TYPE_CHECKING:
    from torch import Tensor


@dataclass(frozen=True)
class GeneralizedLIF:
    """A leaky integrator that fires at its threshold, and is reset at once.

    ::

        C[t] = synapse_decay C[t-1] + I[t]                     or I[t] itself without a synaptic current
        U    = decay U[t-1] + input_gain C[t]
        S[t] = 1 if U >= threshold + adaptation A[t-1], else 0
        U[t] = U (1 - S[t])                                    if it is reset to zero; else U - threshold S[t]
        A[t] = adaptation_decay A[t-1] + S[t]

    Potentials are dimensionless and counted from rest; decays are what is left after one ``spike_step`` of the clock.
    The state (batch, variables x neurons) is, side by side, ``U``, then ``C`` and ``A`` of neurons that have them.
    Sources: Gerstner et al. 2014, Section 1.3 (exact integration); the synaptic current is that of snnTorch's
    ``Synaptic``; the adaptive threshold is that of Bellec et al. 2020, whose ``a[t]`` is ``A[t-1]`` here.

    ``reset_gradient`` says whether the gradient also flows through the reset (``full``) or not (``detached``).
    """

    threshold: float = 1.0
    decay: float = 0.9
    input_gain: float = 1.0
    synapse_decay: float | None = None
    adaptation: float | None = None
    adaptation_decay: float = 0.0
    reset: Literal["zero", "subtract"] = "zero"
    surrogate: Surrogate = Surrogate()
    reset_gradient: Literal["full", "detached"] = "full"

    def __post_init__(self) -> None:
        """Refuse decays outside [0, 1], a threshold at which a resting neuron would fire, and what is not known."""
        for name in ("decay", "synapse_decay", "adaptation_decay"):
            value = getattr(self, name)
            if value is not None and not 0 <= value <= 1:
                raise ValueError(f"the {name} of a neuron lies in 0..1, got {value}")
        if not 0 < self.threshold < math.inf:
            raise ValueError(
                f"the threshold must be positive, or a neuron fires at rest, and finite, got {self.threshold}"
            )
        if not 0 < self.input_gain < math.inf:
            raise ValueError(f"the input_gain must be positive and finite, got {self.input_gain}")
        if self.adaptation is not None and not 0 <= self.adaptation < math.inf:
            raise ValueError(f"the adaptation must not be negative, and be finite, got {self.adaptation}")
        if self.reset not in ("zero", "subtract"):
            raise ValueError(f"a neuron is reset to `zero` or by `subtract`, not {self.reset!r}")
        if self.reset_gradient not in ("full", "detached"):
            raise ValueError(f"the gradient of the reset is `full` or `detached`, not {self.reset_gradient!r}")

    @property
    def variables(self) -> int:
        """How many numbers a neuron remembers."""
        return 1 + (self.synapse_decay is not None) + (self.adaptation is not None)

    def at_rest(self, batch: int, neurons: int) -> "Tensor":
        """Return the resting state (batch, variables x neurons)."""
        import torch

        return torch.zeros(batch, self.variables * neurons)

    def step(self, current: "Tensor", state: "Tensor") -> "tuple[Tensor, Tensor]":
        """Advance one step: input (batch, neurons) and state -> spikes 0/1 and the next state."""
        import torch

        potential, *others = state.chunk(self.variables, dim=1)
        after = []
        if self.synapse_decay is not None:
            current = others[0] * self.synapse_decay + current
            after.append(current)
        potential = potential * self.decay + current * self.input_gain
        distance = potential - self.threshold
        if self.adaptation is not None:
            distance = distance - others[-1] * self.adaptation
        spikes = self.surrogate.fire(distance)
        resets = spikes if self.reset_gradient == "full" else spikes.detach()
        potential = potential * (1 - resets) if self.reset == "zero" else potential - resets * self.threshold
        if self.adaptation is not None:
            after.append(others[-1] * self.adaptation_decay + spikes)
        return spikes, torch.cat([potential, *after], dim=1)
