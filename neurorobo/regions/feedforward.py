"""The general feed-forward region."""

from collections.abc import Mapping
from itertools import pairwise

import torch
from torch import Tensor, nn

from neurorobo.clock import Clock
from neurorobo.engine import Circuit, Layer
from neurorobo.regions.feedforward_config import FeedforwardConfig
from neurorobo.regions.port import Port
from neurorobo.regions.region import Probe, Region, State
from neurorobo.synapses import Dense


class Feedforward(Region):
    """Layers ``hidden_1``, ``hidden_2``, ... and ``output``, each a parameter group of that name."""

    def __init__(self, config: FeedforwardConfig, clock: Clock, generator: torch.Generator) -> None:
        super().__init__(config, clock, generator)
        neuron = config.neuron.build(clock.spike_step_ns)
        sizes = (_channels(self.input_ports), *config.hidden, _channels(self.output_ports))
        names = [*(f"hidden_{number + 1}" for number in range(len(config.hidden))), "output"]
        layers = {
            name: Layer([Dense(before, after, generator, gain=config.gain)], neuron)
            for name, (before, after) in zip(names, pairwise(sizes), strict=True)
        }
        self.layers = nn.ModuleDict(layers)
        reads = [tuple(self.input_ports), *names]
        self._circuit = Circuit(
            self.input_ports, {name: (layers[name], [read]) for name, read in zip(names, reads, strict=False)}
        )

    def init_state(self, batch: int) -> State:
        """Return the states of all layers at rest."""
        return {name: layer.at_rest(batch) for name, layer in self.layers.items()}  # type: ignore[operator]

    def step(
        self, inputs: Mapping[str, Tensor], state: State, probe: Probe | None = None
    ) -> tuple[dict[str, Tensor], State]:
        """Run one window."""
        spikes, after = self._circuit(inputs, state, ["output"], probe)
        parts = spikes["output"].split([port.channels for port in self.output_ports.values()], dim=-1)
        return dict(zip(self.output_ports, parts, strict=True)), after

    def parameter_groups(self) -> Mapping[str, nn.Module]:
        """Return the layers by name."""
        return dict(self.layers.items())


def _channels(ports: Mapping[str, Port]) -> int:
    return sum(port.channels for port in ports.values())
