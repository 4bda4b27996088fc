"""Values in the form that a port carries: numbers or spikes, converted from one code to another."""

from collections.abc import Sequence

import torch
from torch import Tensor

from neurorobo.codes import Code
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
    numbers = value if source is None else source.decode(value)
    if target is None:
        return numbers
    if not target.stochastic:
        return target.encode(numbers, steps)
    rows = zip(numbers.split(1), generators, strict=True)
    return torch.cat([target.encode(row, steps, generator) for row, generator in rows], dim=1)
