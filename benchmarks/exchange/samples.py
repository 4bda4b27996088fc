"""Networks whose spikes are compared between libraries."""

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from neurorobo.clock import Clock
from neurorobo.config.plugged_reader import validation_context
from neurorobo.engine import Circuit
from neurorobo.plugins import Registry
from neurorobo.regions.region import Region
from neurorobo.regions.spiking_network import ALWAYS, Network
from neurorobo.regions.spiking_network_config import NetworkConfig

CLOCK = Clock({"control": 1_000_000_000}, 1_000_000, 50)
SOURCES, OUTPUTS = 20, 10


def network(layers: dict[str, Any], seed: int, **settings: Any) -> Network:
    """Return a network of `SOURCES` channels to `OUTPUTS` neurons with random weights; every layer fires."""
    described = {"inputs": {"x": _port(SOURCES)}, "outputs": {"y": _port(OUTPUTS)}, "layers": layers, "gain": 3.0}
    config = NetworkConfig.model_validate({**described, **settings}, context=validation_context(Registry()))
    region = Network(config, CLOCK, torch.Generator().manual_seed(seed))
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for name, layer in circuit(region).layers.items():
            if config.layers[name].bias:
                *_, projection = layer.projections
                projection.get_parameter("weight").uniform_(-0.3, 0.3, generator=generator)
            if layer.threshold is not None:
                layer.threshold.uniform_(0.1, 1.0, generator=generator)
    return region.eval()


def _port(neurons: int) -> dict[str, Any]:
    return {"unit": "1", "range": "0..1", "code": {"type": "population_uniform", "neurons": neurons}}


def _of(decay: float, **more: Any) -> dict[str, Any]:
    return {"neuron": {"type": "lif", "decay": decay}, **more}


def feedforward(seed: int) -> Network:
    """Two layers, of fast and of slow neurons, with constant currents."""
    return network(
        {
            "hidden": {"neurons": 30, "reads": ["inputs"], "bias": True},
            "output": {"neurons": OUTPUTS, "reads": ["hidden"], **_of(0.9)},
        },
        seed,
    )


def recurrent(seed: int) -> Network:
    """A recurrent layer, and one behind it."""
    return network(
        {
            "hidden": {"neurons": 30, "reads": ["inputs"], "recurrent": True},
            "output": {"neurons": OUTPUTS, "reads": ["hidden"]},
        },
        seed,
    )


def skipping(seed: int) -> Network:
    """A recurrent layer, and one that reads it and the inputs."""
    return network(
        {
            "hidden": {"neurons": 30, "reads": ["inputs"], "recurrent": True, **_of(0.5)},
            "output": {"neurons": OUTPUTS, "reads": ["hidden", "inputs"]},
        },
        seed,
    )


@torch.no_grad()
def on_a_grid(seed: int) -> Network:
    """The recurrent network with weights that are multiples of 1/16: many potentials equal the threshold."""
    region = recurrent(seed)
    for parameter in region.parameters():
        parameter.copy_((parameter * 16).round() / 16)
    return region


NETWORKS: dict[str, Callable[[int], Network]] = {
    "feed-forward, with bias": feedforward,
    "recurrent": recurrent,
    "recurrent, weights on a grid": on_a_grid,
    "recurrent, with a skip": skipping,
}


def circuit(region: Region) -> Circuit:
    """Return the circuit of a region that has one."""
    [found] = [value for value in vars(region).values() if isinstance(value, Circuit)]
    return found


def spikes(region: Region, steps: int, batch: int, seed: int) -> Tensor:
    """Return random spikes (steps, batch, channels) for all inputs, of which three in ten fire."""
    channels = sum(port.channels for port in region.input_ports.values())
    return (torch.rand(steps, batch, channels, generator=torch.Generator().manual_seed(seed)) < 0.3).float()


@torch.no_grad()
def run(region: Region, inputs: Tensor) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
    """Run a region from rest; return its circuit's inputs, and the spikes of all layers."""
    sizes = [port.channels for port in region.input_ports.values()]
    known = dict(zip(region.input_ports, inputs.split(sizes, dim=-1), strict=True))
    if ALWAYS in circuit(region).inputs:
        known[ALWAYS] = inputs.new_ones((*inputs.shape[:2], 1))
    return known, circuit(region)(known)[0]
