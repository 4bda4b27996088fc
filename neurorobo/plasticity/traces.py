"""Traces: what is left of past spikes, fading exponentially."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from torch import Tensor


def with_each_step(values: "Tensor", start: "Tensor", decay: float) -> "tuple[Tensor, Tensor]":
    """Return the trace with the values of each step (steps, batch, neurons), and the one before the next step.

    A trace rises by each of the ``values`` (steps, batch, neurons), which are spikes as a rule, and fades to ``decay``
    (0..1) of itself from step to step; ``start`` (batch, neurons) is the trace before the first step.
    """
    import torch

    found, lag = torch.cat([(values[0] + start).unsqueeze(0), values[1:]]), 1
    while lag < len(values):  # now it has `lag` steps behind each one; with itself, twice as many
        found = torch.cat([found[:lag], found[lag:] + decay**lag * found[:-lag]])
        lag *= 2
    return found, decay * found[-1]


def before_each_step(values: "Tensor", start: "Tensor", decay: float) -> "tuple[Tensor, Tensor]":
    """Return the trace just before the values of each step, and the one before the next step; see above."""
    found, after = with_each_step(values, start, decay)
    return found - values, after
