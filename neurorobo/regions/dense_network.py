"""A network of plain numbers, without spikes."""

from collections.abc import Mapping
from itertools import pairwise

import torch
from torch import Tensor, nn

from neurorobo.clock import Clock
from neurorobo.regions.dense_network_config import DenseNetworkConfig, RangedPort
from neurorobo.regions.region import Probe, Region, State

SMALL = 0.01
"""The gain of fresh weights to the outputs, so that they begin in the middle of their ranges."""


class DenseNetwork(Region):
    """Layers ``hidden_1``, ``hidden_2``, ... of tanh units and a linear ``output``, each a parameter group.

    Inputs and outputs are in units of their ranges, -1..1; nothing is clipped. Fresh weights are orthogonal, and biases
    zero.
    """

    def __init__(self, config: DenseNetworkConfig, clock: Clock, generator: torch.Generator) -> None:
        super().__init__(config, clock, generator)
        self._receives, self._sends = config.receives, config.sends
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
        scaled = []
        for name, port in self._receives.items():
            middle, half = _scale(port)
            scaled.append((inputs[name] - middle) / half)
        values = torch.cat(scaled, dim=-1)
        for name, layer in self.layers.items():
            values = layer(values) if name == "output" else layer(values).tanh()
        outputs = {}
        for (name, port), part in zip(
            self._sends.items(), values.split([port.width for port in self._sends.values()], dim=-1), strict=True
        ):
            middle, half = _scale(port)
            outputs[name] = middle + half * part
        return outputs, state

    def parameter_groups(self) -> Mapping[str, nn.Module]:
        """Return the layers by name."""
        return dict(self.layers.items())


def _width(ports: Mapping[str, RangedPort]) -> int:
    return sum(port.width for port in ports.values())


def _scale(port: RangedPort) -> tuple[float, float]:
    """Return the middle and half the width of the range."""
    return (port.interval.lo + port.interval.hi) / 2, (port.interval.hi - port.interval.lo) / 2
