"""Values in the form that a port carries: numbers or spikes, converted from one code to another."""

from collections.abc import Sequence

import torch
from torch import Tensor

from neurorobo.codes import Code
from neurorobo.engine.coding import decode, encode
from neurorobo.regions.port import Port


def initial_value(port: Port, batch: int, steps: int, generators: Sequence[torch.Generator]) -> Tensor:
    """Return the initial value of a port in the form that it carries; zero, or silence, where it declares none."""
    if port.initial is None:
        return torch.zeros((batch, port.width) if port.code is None else (steps, batch, port.channels))
    return convert(torch.tensor(port.initial).expand(batch, -1), None, port.code, steps, generators)


def convert(
    value: Tensor, source: Code | None, target: Code | None, steps: int, generators: Sequence[torch.Generator]
) -> Tensor:
    """Bring a value from one code to another; ``None`` stands for numbers. Recoding counts, requantises and re-emits.

    Numbers are (batch, width), spikes (steps, batch, width * neurons). A stochastic code draws the spikes of each
    member of the batch from that member's generator; no other code needs ``generators``.
    """
    if source == target:
        return value
    return from_numbers(to_numbers(value, source), target, steps, generators)


def to_numbers(value: Tensor, source: Code | None) -> Tensor:
    """Return the numbers (batch, width) of a value in some code, or that has none."""
    return value if source is None else decode(source, value)


def from_numbers(numbers: Tensor, target: Code | None, steps: int, generators: Sequence[torch.Generator]) -> Tensor:
    """Return numbers (batch, width) in a code, or as they are if it is None."""
    if target is None:
        return numbers
    if not target.stochastic:
        return encode(target, numbers, steps)
    rows = zip(numbers.split(1), generators, strict=True)
    return torch.cat([target.encode(row, steps, generator) for row, generator in rows], dim=1)
