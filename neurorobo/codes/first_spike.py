"""Time to first spike: the larger the value, the earlier the spike."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from neurorobo.codes.code import Code, by_component

if TYPE_CHECKING:
    import torch
    from torch import Tensor


@dataclass(frozen=True)
class TimeToFirstSpike(Code):
    """Every neuron fires once; the sum of the latencies tells the value.

    ``hi`` fires at the first step, ``lo`` at the last. Of N neurons some fire one step earlier than the others, so
    that a window of T steps resolves ``(hi - lo) / (N * (T - 1))``: the latencies ``floor((L + n) / N)``, n = 0..N-1,
    sum to L (Hermite's identity). A neuron that stays silent counts as firing at the last step.
    """

    @property
    def differentiable(self) -> bool:
        """Which step is a neuron's first has no gradient."""
        return False

    def resolution(self, steps: int) -> float:
        """Return the value of one step of one neuron's latency."""
        if steps < 2:
            raise ValueError("time to first spike needs a window of at least two steps; give it more, under `time`")
        return (self.hi - self.lo) / (self.neurons * (steps - 1))

    def encode(self, values: "Tensor", steps: int, generator: "torch.Generator | None" = None) -> "Tensor":
        """Return the spikes of ``values``; deterministic."""
        import torch

        self.resolution(steps)
        total = ((1 - self.fraction(values)) * (self.neurons * (steps - 1))).round().long()
        shift = torch.arange(self.neurons, device=values.device)
        latency = (total.unsqueeze(-1) + shift).div(self.neurons, rounding_mode="floor").flatten(1)
        return (torch.arange(steps, device=values.device).view(-1, 1, 1) == latency).to(values.dtype)

    def decode(self, spikes: "Tensor") -> "Tensor":
        """Sum the latencies of each component; not differentiable."""
        steps = len(spikes)
        silent = spikes.amax(0) == 0
        latency = spikes.argmax(0).masked_fill(silent, steps - 1)
        total = by_component(latency, self.neurons).sum(-1)
        return self.hi - total.to(spikes.dtype) * self.resolution(steps)
