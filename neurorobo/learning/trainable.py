"""What training changes: the parameters that learn, and the optimiser that moves them."""

from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager

import torch
from torch import nn

from neurorobo.regions.region import Region


@contextmanager
def only_learning(regions: Collection[Region], parameters: Iterable[nn.Parameter]) -> Iterator[None]:
    """Let gradients flow into the ``parameters`` of the regions, and into no others; drop them in the end."""
    chosen = {id(parameter) for parameter in parameters}
    before = [(each, each.requires_grad) for region in regions for each in region.parameters()]
    try:
        for parameter, _ in before:
            parameter.requires_grad_(id(parameter) in chosen)
        yield
    finally:
        for parameter, required in before:
            parameter.requires_grad_(required)
            parameter.grad = None


def adam(parameters: Iterable[nn.Parameter]) -> torch.optim.Adam:
    """Return Adam, whose steps are as large as 1/sqrt(fan-in), of which weights are drawn.

    Of thresholds, one per neuron, they are as large as 1/sqrt(neurons).
    """
    groups = [{"params": [parameter], "scale": parameter.shape[-1] ** -0.5} for parameter in parameters]
    return torch.optim.Adam(groups, betas=(0.9, 0.99), fused=True)


def set_learning_rate(optimiser: torch.optim.Adam, rate: float) -> None:
    """Set the learning rate of a parameter with a fan-in of 1."""
    for group in optimiser.param_groups:
        group["lr"] = rate * group["scale"]
