"""A network of plain numbers, without spikes."""

from collections.abc import Mapping
from itertools import pairwise

import torch
from torch import Tensor, nn

from neurorobo.clock import Clock
from neurorobo.regions.dense_network_config import DenseNetworkConfig
from neurorobo.regions.ranged_port import RangedPort
from neurorobo.regions.region import Probe, Region, State
from neurorobo.units import Interval

SMALL = 0.01
"""The gain of fresh weights to the outputs, so that they begin in the middle of their ranges."""


class DenseNetwork(Region):
    """Layers ``hidden_1``, ``hidden_2``, ... of tanh units and a linear ``output``, each a parameter group.

    Inputs and outputs are in units of their ranges, -1..1; nothing is clipped. Fresh weights are orthogonal, and biases
    zero.
    """

    def __init__(self, config: DenseNetworkConfig, clock: Clock, generator: torch.Generator) -> None:
        super().__init__(config, clock, generator)
        self._receives = {name: _middle_and_half(port.interval) for name, port in config.receives.items()}
        self._sends = {name: _middle_and_half(port.interval) for name, port in config.sends.items()}
        sizes = (_width(config.receives), *config.hidden, _width(config.sends))
        names = [*(f"hidden_{number + 1}" for number in range(len(config.hidden))), "output"]
        self.layers = nn.ModuleDict()
        for name, (before, after) in zip(names, pairwise(sizes), strict=True):
            layer = nn.Linear(before, after, device="meta").to_empty(device="cpu")  # drawing nothing by itself
            nn.init.orthogonal_(layer.weight, SMALL if name == "output" else 2**0.5, generator=generator)
            nn.init.zeros_(layer.bias)
            self.layers[name] = layer

    def step(
        self, inputs: Mapping[str, Tensor], state: State, probe: Probe | None = None
    ) -> tuple[dict[str, Tensor], State]:
        """Compute the outputs (batch, width)."""
        values = torch.cat([(inputs[name] - middle) / half for name, (middle, half) in self._receives.items()], dim=-1)
        for name, layer in self.layers.items():
            values = layer(values) if name == "output" else layer(values).tanh()
        parts = values.split([port.width for port in self.output_ports.values()], dim=-1)
        scales = self._sends.items()
        return {name: middle + half * part for (name, (middle, half)), part in zip(scales, parts, strict=True)}, state

    def parameter_groups(self) -> Mapping[str, nn.Module]:
        """Return the layers by name."""
        return dict(self.layers.items())


def _width(ports: Mapping[str, RangedPort]) -> int:
    return sum(port.width for port in ports.values())


def _middle_and_half(interval: Interval) -> tuple[float, float]:
    """Return the middle of an interval, and half its width."""
    return (interval.lo + interval.hi) / 2, (interval.hi - interval.lo) / 2
