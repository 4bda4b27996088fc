"""Weights that have been looked at: finite, and packed for the kernels; once for each time that they change.

And how to look at what comes anew with each window.
"""

import math
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.optim.optimizer import register_optimizer_step_post_hook

from neurorobo.engine.kernels import Kernels, Packed, not_a_spike, not_finite

NUMBERS_AT_ONCE = 2**16
"""Of so many numbers, several such tensors stay in a processor's cache."""

_optimiser_steps = 0


def _count_step(*_: object) -> None:
    global _optimiser_steps
    _optimiser_steps += 1


register_optimizer_step_post_hook(_count_step)  # torch's fused optimisers leave a tensor's version as it was


class Seen(NamedTuple):
    """A tensor at one version; holding it, and what it shared memory with, keeps both from being given away."""

    tensor: Tensor
    memory: Tensor
    pointer: int
    version: int
    steps: int
    packed: Packed | None

    def is_still(self, tensor: Tensor) -> bool:
        """Return whether this is the same tensor, unchanged."""
        return (
            tensor is self.tensor
            and tensor._version == self.version
            and tensor.data_ptr() == self.pointer
            and self.steps == _optimiser_steps
        )


class CheckedWeights:
    """What one layer remembers of its weights; it is derived from them, and neither saved nor copied.

    A change is noticed if torch counts it: whatever is done to a parameter itself, be it in place or by replacing it,
    and each step of an optimiser; but not what is written through its ``.data`` or memory that NumPy shares.
    """

    def __init__(self) -> None:
        self._seen: dict[str, Seen] = {}

    def __reduce__(self) -> tuple[Any, ...]:
        return CheckedWeights, ()

    def check(self, name: str, weight: Tensor) -> None:
        """Raise a ValueError, which says the name and the place, unless all weights are finite."""
        seen = self._seen.get(name)
        if seen is None or not seen.is_still(weight):
            if not is_finite(weight):
                finite = weight.isfinite()
                place = (~finite).nonzero()[0].tolist()
                raise ValueError(f"{name}: {not_finite(weight, place)}")
            self._keep(name, weight, None)

    def check_index(self, name: str, index: Tensor, shape: tuple[int, int], sources: int) -> None:
        """Raise a ValueError, which says the name and the place, unless an index of that shape names sources."""
        name = f"{name}: source_index"
        if index.dtype is not torch.int64 or index.shape != shape:
            raise ValueError(f"{name} is of torch.int64 and {shape}, got {index.dtype} and {tuple(index.shape)}")
        seen = self._seen.get(name)
        if seen is None or not seen.is_still(index):
            wrong = (index < 0) | (index >= sources)
            if wrong.any():
                place = wrong.nonzero()[0].tolist()
                raise ValueError(f"{name} lies in 0..{sources - 1}, got {index[tuple(place)].item()} at {place}")
            self._keep(name, index, None)

    def packed(self, name: str, weight: Tensor, kernels: Kernels, *, narrow: bool) -> Packed:
        """Return the weights (targets, sources) as the kernels want them; raises as :meth:`check` does.

        ``narrow`` asks to see whether they fit into fewer bits, which is not worth its time for weights in training.
        """
        seen = self._seen.get(name)
        if seen is not None and seen.packed is not None and seen.is_still(weight) and seen.packed.serves(narrow):
            return seen.packed
        try:
            old = seen.packed if seen is not None and seen.tensor is weight else None
            packed = kernels.pack_weights(weight, old, narrow=narrow)
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from None
        self._keep(name, weight, packed)
        return packed

    def seen(self, name: str) -> Seen | None:
        """Return what was last kept under a name, if anything."""
        return self._seen.get(name)

    def _keep(self, name: str, weight: Tensor, packed: Packed | None) -> None:
        if weight.is_inference():  # its changes are not counted
            return
        # A tensor that is part of a graph would keep the graph.
        if weight.grad_fn is None:
            memory = weight.detach()
            self._seen[name] = Seen(weight, memory, memory.data_ptr(), weight._version, _optimiser_steps, packed)


def is_finite(tensor: Tensor) -> bool:
    """Return whether all numbers are finite."""
    tensor = tensor.detach()
    # If their sum is, all are, and to add takes one operation in place of five; but a sum may also overflow.
    return math.isfinite(tensor.sum()) or bool(tensor.isfinite().all())


def steps_at_once(window: Tensor) -> int:
    """Return how many steps of a window (steps, batch, neurons) stay in the cache together; at least one."""
    return max(1, NUMBERS_AT_ONCE // max(1, window[0].numel()))


def check_spikes(spikes: Tensor, first: int = 0) -> None:
    """Raise a ValueError, which says the place, unless all spikes (steps, batch, sources) are 0 or 1.

    The batch is counted from ``first`` on.
    """
    spikes = spikes.detach()
    # Only 0 and 1 are their own squares. Others add to the sum by how much they are not, or turn it into a NaN.
    pieces = spikes.split(steps_at_once(spikes))
    if any(torch.addcmul(x, x, x, value=-1).abs_().sum().item() for x in pieces):
        fine = (spikes == 0) | (spikes == 1)
        step, element, source = (~fine).nonzero()[0].tolist()
        raise ValueError(not_a_spike(spikes[step, element, source].item(), step, first + element, source))
