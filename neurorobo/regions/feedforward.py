"""The general feed-forward region."""

from collections.abc import Mapping
from itertools import pairwise

import torch
from torch import Tensor, nn

from neurorobo.clock import Clock
from neurorobo.engine import Layer
from neurorobo.regions.feedforward_config import FeedforwardConfig
from neurorobo.regions.port import Port
from neurorobo.regions.region import Probe, Region, State
from neurorobo.synapses import Dense


class Feedforward(Region):
    """Layers ``hidden_1``, ``hidden_2``, ... and ``output``, each a parameter group of that name."""

    def __init__(self, config: FeedforwardConfig, clock: Clock, generator: torch.Generator) -> None:
        super().__init__(config, clock, generator)
        neuron = config.neuron.build()
        sizes = (_channels(self.input_ports), *config.hidden, _channels(self.output_ports))
        names = [*(f"hidden_{number + 1}" for number in range(len(config.hidden))), "output"]
        self.layers = nn.ModuleDict(
            {
                name: Layer([Dense(before, after, generator, gain=config.gain)], neuron)
                for name, (before, after) in zip(names, pairwise(sizes), strict=True)
            }
        )

    def init_state(self, batch: int) -> State:
        """Return the states of all layers at rest."""
        return {name: layer.at_rest(batch) for name, layer in self.layers.items()}  # type: ignore[operator]

    def step(
        self, inputs: Mapping[str, Tensor], state: State, probe: Probe | None = None
    ) -> tuple[dict[str, Tensor], State]:
        """Run one window, layer by layer."""
        spikes = torch.cat([inputs[name] for name in self.input_ports], dim=-1)
        after = {}
        for name, layer in self.layers.items():
            spikes, after[name] = layer([spikes], state[name])
            if probe is not None:
                probe(name, spikes)
        parts = spikes.split([port.channels for port in self.output_ports.values()], dim=-1)
        return dict(zip(self.output_ports, parts, strict=True)), after

    def parameter_groups(self) -> Mapping[str, nn.Module]:
        """Return the layers by name."""
        return dict(self.layers.items())


def _channels(ports: Mapping[str, Port]) -> int:
    return sum(port.channels for port in ports.values())
