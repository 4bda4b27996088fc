"""Rank order: which neuron fires first, which second, and so on; the times themselves tell nothing."""

from dataclasses import dataclass
from functools import cache
from itertools import combinations
from typing import TYPE_CHECKING, Literal

from pydantic import Field

from neurorobo.codes.code import Code, by_component
from neurorobo.codes.config import CodeConfig
from neurorobo.errors import NeuroroboError

if TYPE_CHECKING:
    import torch
    from torch import Tensor

LEAST_NEURONS = 2
"""One neuron alone has no order."""


@dataclass(frozen=True)
class RankOrder(Code):
    """Every neuron fires once, in an order that tells the value; the neuron that prefers it most fires first.

    The N neurons prefer evenly spaced places, and fire the earlier, the nearer the value is to theirs. At ``lo`` the
    order is 0, 1, ..., N-1; on the way to ``hi`` each two neurons exchange once, where the value passes the middle
    between them (pairs with the same middle one after the other), until all is reversed. These ``N (N - 1) / 2``
    exchanges are spread evenly over the range, and how many have happened, Kendall's distance from the order at ``lo``,
    is the value. So the resolution is ``(hi - lo) / (N (N - 1) / 2)``, whatever the window: a delay or any stretch of
    time changes nothing, and where two neurons that follow one another exchange by mistake, the value is off by one
    resolution. Neurons that fire together, or stay silent together, count as half exchanged.

    A NeuroroboError if the window has not a step for each neuron. Source: rank order coding (Thorpe and Gautrais 1998;
    VanRullen and Thorpe 2001), with Kendall's distance (Kendall 1938) as the decoder, as it is exact.
    """

    def __post_init__(self) -> None:
        """Refuse a single neuron."""
        super().__post_init__()
        if self.neurons < LEAST_NEURONS:
            raise ValueError(f"an order needs {LEAST_NEURONS} neurons or more (got {self.neurons})")

    @property
    def differentiable(self) -> bool:
        """Who fires before whom has no gradient."""
        return False

    @property
    def pairs(self) -> int:
        """How many pairs of neurons there are, each of which exchanges once over the range."""
        return self.neurons * (self.neurons - 1) // 2

    def resolution(self, steps: int) -> float:
        """Return the value of one exchange."""
        if steps < self.neurons:
            raise NeuroroboError(
                f"the order of {self.neurons} neurons does not fit into a window of {steps} steps; give the code fewer "
                "neurons, or the window more steps, under `time`"
            )
        return (self.hi - self.lo) / self.pairs

    def encode(self, values: "Tensor", steps: int, generator: "torch.Generator | None" = None) -> "Tensor":
        """Return the spikes of ``values``, spread evenly over the window; deterministic."""
        import torch

        self.resolution(steps)
        exchanges = (self.fraction(values) * self.pairs).round().long()
        rank = _ranks(self.neurons).to(values.device)[exchanges].flatten(1)
        time = (rank * steps).div(self.neurons, rounding_mode="floor")
        return (torch.arange(steps, device=values.device).view(-1, 1, 1) == time).to(values.dtype)

    def decode(self, spikes: "Tensor") -> "Tensor":
        """Count, for each component, the pairs that have exchanged; not differentiable."""
        import torch

        silent = spikes.amax(0) == 0
        time = by_component(spikes.argmax(0).masked_fill(silent, len(spikes)), self.neurons)
        first, second = torch.triu_indices(self.neurons, self.neurons, offset=1, device=spikes.device)
        exchanged = (1 + (time[..., first] - time[..., second]).sign().to(spikes.dtype)) / 2
        return self.lo + exchanged.sum(-1) * self.resolution(len(spikes))


@cache
def _ranks(neurons: int) -> "Tensor":
    """Return the rank of each neuron after 0, 1, 2, ... exchanges, (pairs + 1, neurons)."""
    import torch

    rank = list(range(neurons))
    ranks = [tuple(rank)]
    for one, other in sorted(combinations(range(neurons), 2), key=sum):  # by the middle between their places
        rank[one], rank[other] = rank[other], rank[one]
        ranks.append(tuple(rank))
    with torch.inference_mode(False):
        return torch.tensor(ranks)


class RankOrderConfig(CodeConfig):
    """One spike of each neuron, the value in their order; nothing can be trained through its decoding."""

    type: Literal["rank_order"] = "rank_order"
    neurons: int = Field(default=10, ge=LEAST_NEURONS, description="Neurons of each component of the quantity.")

    def build(self, lo: float, hi: float) -> RankOrder:
        """Return the code."""
        return RankOrder(self.neurons, lo, hi)
