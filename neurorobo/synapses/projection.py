"""Projections: how the spikes of one population become the input currents of another."""

from abc import ABC, abstractmethod
from typing import Literal

import torch
from torch import Tensor, nn

from neurorobo.synapses.product import linear

Sign = Literal["excitatory", "inhibitory"]

MOST_SYNAPSES = 2**31
"""Of one projection, whether all of them exist or only some are drawn."""


class Projection(nn.Module, ABC):
    """A matrix of synaptic weights from ``sources`` to ``targets``, whose signs may be fixed by Dale's law.

    ``weight`` is the trainable tensor; ``matrix()`` is the full (targets, sources) matrix it stands for. What it reads
    are spikes, or, if it is set ``graded``, the numbers that soft units send.
    """

    weight: nn.Parameter
    graded: bool = False

    def __init__(self, sources: int, targets: int, sign: Sign | None) -> None:
        super().__init__()
        if sources < 1 or targets < 1:
            raise ValueError(f"a projection has at least one source and one target, got {sources} and {targets}")
        if sources * targets > MOST_SYNAPSES:
            raise ValueError(
                f"a projection of {sources} sources onto {targets} targets would have {sources * targets} synapses, "
                f"more than {MOST_SYNAPSES}; divide it"
            )
        self.sources = sources
        self.targets = targets
        self.sign = sign

    @abstractmethod
    def matrix(self) -> Tensor:
        """Return the weights as one matrix (targets, sources)."""

    def forward(self, spikes: Tensor) -> Tensor:
        """Turn spikes (..., sources) into currents (..., targets); a ValueError if there are more or fewer sources."""
        if spikes.shape[-1] != self.sources:
            raise ValueError(f"a projection of {self.sources} sources was given the spikes of {spikes.shape[-1]}")
        return linear(spikes, self.matrix())

    @torch.no_grad()
    def constrain(self) -> None:
        """Bring every weight back to its allowed sign; the trainer calls this after each step."""
        if self.sign == "excitatory":
            self.weight.clamp_(min=0)
        elif self.sign == "inhibitory":
            self.weight.clamp_(max=0)

    def _initialise(self, shape: tuple[int, ...], fan_in: int, gain: float, generator: torch.Generator) -> None:
        """Draw weights of standard deviation ``gain / sqrt(fan_in)``; of that magnitude if the sign is fixed."""
        weight = torch.randn(shape, generator=generator) * (gain / fan_in**0.5)
        if self.sign is not None:
            weight = weight.abs() * (1 if self.sign == "excitatory" else -1)
        self.weight = nn.Parameter(weight)


class Dense(Projection):
    """All-to-all projection; with equal populations it also serves as a recurrent one."""

    def __init__(
        self, sources: int, targets: int, generator: torch.Generator, *, gain: float = 1.0, sign: Sign | None = None
    ) -> None:
        super().__init__(sources, targets, sign)
        self._initialise((targets, sources), sources, gain, generator)

    def matrix(self) -> Tensor:
        """Return the weights (targets, sources)."""
        return self.weight


class FanIn(Projection):
    """Each target reads exactly ``fan_in`` different sources, drawn once; only their weights are trained."""

    source_index: Tensor

    def __init__(
        self,
        sources: int,
        targets: int,
        fan_in: int,
        generator: torch.Generator,
        *,
        gain: float = 1.0,
        sign: Sign | None = None,
    ) -> None:
        super().__init__(sources, targets, sign)
        if not 1 <= fan_in <= sources:
            raise ValueError(f"a fan-in of {fan_in} cannot be drawn from {sources} sources")
        order = torch.rand(targets, sources, generator=generator).argsort(1)
        self.register_buffer("source_index", order[:, :fan_in].clone())
        self._initialise((targets, fan_in), fan_in, gain, generator)

    def matrix(self) -> Tensor:
        """Return the weights (targets, sources), zero where there is no synapse."""
        empty = self.weight.new_zeros(self.targets, self.sources)
        return empty.scatter(1, self.source_index, self.weight)
