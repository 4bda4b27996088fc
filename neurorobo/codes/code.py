"""What every code is: a named, invertible map between a physical quantity and a window of spikes."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import torch
    from torch import Tensor


@dataclass(frozen=True)
class Code(ABC):
    """A map between values in ``lo..hi``, in the unit of the port that carries the code, and spikes of neurons.

    Each component of a quantity has ``neurons`` of its own: values (batch, width) become spikes (steps, batch, width *
    neurons), 0 or 1. Values out of range saturate, never wrap; :meth:`saturated` tells which ones did.
    """

    neurons: int
    lo: float
    hi: float

    def __post_init__(self) -> None:
        """Refuse an empty population and an empty range."""
        if self.neurons < 1:
            raise ValueError(f"a code needs at least one neuron (got {self.neurons}); give it 1 or more")
        if not self.lo < self.hi:
            raise ValueError(f"a code needs a range that rises (got {self.lo}..{self.hi}); give the smaller end first")

    @abstractmethod
    def resolution(self, steps: int) -> float:
        """Return the difference between neighbouring values that a window of ``steps`` can tell apart."""

    @abstractmethod
    def encode(self, values: "Tensor", steps: int, generator: "torch.Generator | None" = None) -> "Tensor":
        """Return the spikes (steps, batch, width * neurons) of ``values`` (batch, width)."""

    @abstractmethod
    def decode(self, spikes: "Tensor") -> "Tensor":
        """Return the values (batch, width) of ``spikes`` (steps, batch, width * neurons)."""

    @property
    def stochastic(self) -> bool:
        """Whether :meth:`encode` draws from its generator."""
        return False

    @property
    def differentiable(self) -> bool:
        """Whether gradients flow through :meth:`decode`, so that a region can be taught what it says in this code."""
        return True

    def saturated(self, values: "Tensor") -> "Tensor":
        """Return which ``values`` lie outside the range, as booleans of their shape."""
        return (values < self.lo) | (values > self.hi)

    def may_saturate(self, values: "Tensor") -> bool:
        """Return False if no value lies outside the range; a fast question before :meth:`saturated`."""
        return bool(self.saturated(values).any())

    def fraction(self, values: "Tensor") -> "Tensor":
        """Return where ``values`` lie in the range, clipped to 0..1; a ValueError if any is not finite."""
        if not values.isfinite().all():
            raise ValueError(f"a value that is not finite cannot be encoded over {self.lo:g}..{self.hi:g}")
        return ((values - self.lo) / (self.hi - self.lo)).clamp(0, 1)


def by_component(values: "Tensor", neurons: int) -> "Tensor":
    """Return values (..., width * neurons) as (..., width, neurons)."""
    return values.reshape(*values.shape[:-1], values.shape[-1] // neurons, neurons)  # -1 has no meaning in a batch of 0
