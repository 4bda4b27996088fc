"""The same quantity in two codes side by side: the whole range coarsely, the part that matters finely."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from neurorobo.codes.code import Code, by_component

if TYPE_CHECKING:
    import torch
    from torch import Tensor


@dataclass(frozen=True)
class CoarseFine(Code):
    """A coarse code over ``coarse.lo..coarse.hi`` beside a fine one over a part of it.

    Decodes to the fine code's value unless that one is at an end of its range: then the coarse code tells how far
    beyond that end the value lies. Build it with :meth:`of`.
    """

    coarse: Code
    fine: Code

    @classmethod
    def of(cls, coarse: Code, fine: Code) -> "CoarseFine":
        """Join two codes; the fine range must lie within the coarse one."""
        if not coarse.lo <= fine.lo < fine.hi <= coarse.hi:
            raise ValueError(f"the fine range {fine.lo}..{fine.hi} must lie within the coarse {coarse.lo}..{coarse.hi}")
        return cls(coarse.neurons + fine.neurons, coarse.lo, coarse.hi, coarse, fine)

    @property
    def stochastic(self) -> bool:
        """Whether either part draws its spikes."""
        return self.coarse.stochastic or self.fine.stochastic

    @property
    def differentiable(self) -> bool:
        """Whether gradients flow through both parts."""
        return self.coarse.differentiable and self.fine.differentiable

    def resolution(self, steps: int) -> float:
        """Return the coarse resolution, which holds everywhere."""
        return self.coarse.resolution(steps)

    def encode(self, values: "Tensor", steps: int, generator: "torch.Generator | None" = None) -> "Tensor":
        """Return the spikes of ``values``: per component the coarse neurons, then the fine ones."""
        return self.joined(*(code.encode(values, steps, generator) for code in (self.coarse, self.fine)))

    def joined(self, coarse: "Tensor", fine: "Tensor") -> "Tensor":
        """Return the spikes of this code, of those of its two parts."""
        import torch

        parts = (by_component(coarse, self.coarse.neurons), by_component(fine, self.fine.neurons))
        return torch.cat(parts, dim=-1).flatten(2)

    def decode(self, spikes: "Tensor") -> "Tensor":
        """Read the fine code where it is inside its range, else the coarse one, which then cannot lie inside."""
        import torch

        steps = len(spikes)
        each = by_component(spikes, self.neurons)
        coarse = self.coarse.decode(each[..., : self.coarse.neurons].flatten(2))
        fine = self.fine.decode(each[..., self.coarse.neurons :].flatten(2))
        margin = self.coarse.resolution(steps)
        inside = (coarse >= self.fine.lo - margin) & (coarse <= self.fine.hi + margin)
        half = self.fine.resolution(steps) / 2  # rounding may leave the decoded end a little short of the end
        read = torch.where(fine > self.fine.hi - half, coarse.clamp(min=self.fine.hi), fine)
        read = torch.where(fine < self.fine.lo + half, coarse.clamp(max=self.fine.lo), read)
        return torch.where(inside, read, coarse)
