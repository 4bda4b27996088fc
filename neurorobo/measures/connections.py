"""The weight matrices of a region: which modules hold them, and how many targets each source has there."""

from collections.abc import Iterator

import torch
from torch import Tensor, nn

from neurorobo.engine import Circuit, Layer
from neurorobo.regions.region import Region
from neurorobo.regions.spiking_network import ALWAYS
from neurorobo.synapses import Projection

Connections = Projection | nn.Linear
"""What holds a weight matrix, and is counted."""


def connections(region: Region) -> Iterator[Connections]:
    """Yield everything in a region that holds a weight matrix; biases are none (as in NeuroBench)."""
    constant = set(biases(region))
    return (module for module in region.modules() if isinstance(module, Connections) and module not in constant)


def biases(region: Region) -> Iterator[Projection]:
    """Yield the projections that bring a layer constant currents."""
    for circuit in circuits(region):
        for name, readings in circuit.readings.items():
            for projection, reads in zip(circuit.layers[name].projections, readings, strict=True):
                if reads == (ALWAYS,) and isinstance(projection, Projection):
                    yield projection


def circuits(region: Region) -> Iterator[Circuit]:
    """Yield the circuits that a region holds."""
    return (value for value in vars(region).values() if isinstance(value, Circuit))


def layers(region: Region) -> Iterator[Layer]:
    """Yield the spiking layers of a region."""
    return (module for module in region.modules() if isinstance(module, Layer))


def fan_out(module: Connections) -> tuple[Tensor, int]:
    """Return how many weights of each source are not zero (sources), and how many there could be for each."""
    matrix = module.matrix() if isinstance(module, Projection) else module.weight
    return (matrix != 0).sum(0, dtype=torch.float64), len(matrix)
