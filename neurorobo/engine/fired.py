"""Who listens to the spikes inside a region, and what a layer fired, as bits."""

from typing import NamedTuple, Protocol

import torch
from torch import Tensor

from neurorobo.engine.kernels import Kernels


class Probe(Protocol):
    """Listens to the spikes inside a region."""

    def __call__(self, layer: str, spikes: Tensor) -> None:
        """Take the spikes (steps, batch, neurons) of one layer."""


class BitProbe(Probe, Protocol):
    """A probe that can do with bits, which spares writing spikes that nobody looks at one by one."""

    def hear(self, layer: str, fired: "Fired") -> None:
        """Take what one layer fired, instead of being called with its spikes; to be kept, it must be read at once."""


class Fired(NamedTuple):
    """The spikes of a layer in a window, as ``words`` (steps, batch, words of 64 neurons)."""

    native: Kernels
    words: Tensor
    steps: int
    neurons: int

    def counts(self) -> Tensor:
        """Return the number of spikes (batch)."""
        return self.native.count(self.words)

    def of(self, neurons: Tensor) -> Tensor:
        """Return, as booleans, the spikes (steps, batch, some) of some neurons by number (some).

        Raises a ValueError if a number is not one of a neuron.
        """
        if neurons.dtype is not torch.int64 or not neurons.is_cpu or neurons.dim() != 1:
            raise ValueError(
                f"numbers of neurons are a row of torch.int64 on the CPU, got {neurons.dtype} "
                f"of {tuple(neurons.shape)} on {neurons.device}"
            )
        return self.native.pick(self.words, self.neurons, neurons)
