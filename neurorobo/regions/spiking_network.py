"""Networks that are written down layer by layer."""

from abc import ABC
from collections.abc import Collection, Mapping

import torch
from torch import Tensor, nn

from neurorobo.clock import Clock
from neurorobo.engine import Circuit, Layer
from neurorobo.engine.circuit import Reads
from neurorobo.regions.region import Probe, Region, State
from neurorobo.regions.spiking_network_config import INPUTS, LayeredNetworkConfig
from neurorobo.synapses import Dense, Projection

ALWAYS = "1"
"""The circuit's input that fires in every step: the source of constant currents. No port has such a name."""

_PREFIX = "layer_"  # torch refuses the names of a module's own attributes, such as `train`


class LayeredNetwork(Region, ABC):
    """Base of networks: the layers of a configuration, each a parameter group of that name."""

    config: LayeredNetworkConfig

    def __init__(self, config: LayeredNetworkConfig, clock: Clock, generator: torch.Generator) -> None:
        super().__init__(config, clock, generator)
        inputs = tuple(config.receives)
        sizes = {name: self.input_ports[name].channels for name in inputs}
        sizes[INPUTS] = sum(sizes.values())
        self.layers = nn.ModuleDict()
        stages: dict[str, tuple[Layer, list[Reads]]] = {}
        for name, layer in config.layers.items():
            projections = [self._projection(name, read, sizes[read], generator) for read in layer.reads]
            reads: list[Reads] = [inputs if read == INPUTS else read for read in layer.reads]
            if layer.bias:
                projections.append(Dense(1, layer.neurons, generator, gain=0.0))
                reads.append(ALWAYS)
            for projection, read in zip(projections, layer.reads, strict=False):  # the last one may be the bias
                projection.graded = read in config.layers and not config.layers[read].neuron.sends_spikes
            recurrent = self._recurrent(name, generator) if layer.recurrent else None
            neuron = layer.neuron.build(clock.spike_step_ns)
            built = Layer(projections, neuron, recurrent, trainable_threshold=layer.own_thresholds)
            self.layers[_PREFIX + name] = built
            stages[name] = (built, reads)
            sizes[name] = layer.neurons
        self._circuit = Circuit([*inputs, ALWAYS], stages)

    def init_state(self, batch: int) -> State:
        """Return the states of all layers at rest."""
        return {name: layer.at_rest(batch) for name, layer in self._circuit.layers.items()}

    def run_layers(
        self, inputs: Mapping[str, Tensor], state: State, wanted: Collection[str], probe: Probe | None
    ) -> tuple[dict[str, Tensor], State]:
        """Run one window of the layers; return the spikes of those that are ``wanted``, and the states of all."""
        some = next(iter(inputs.values()))
        ones = some.new_ones((*some.shape[:2], 1))
        return self._circuit({**inputs, ALWAYS: ones}, state, wanted, probe)

    def _projection(self, layer: str, read: str, sources: int, generator: torch.Generator) -> Projection:
        """Return fresh synapses onto a layer."""
        return Dense(sources, self.config.layers[layer].neurons, generator, gain=self.config.gain)

    def _recurrent(self, layer: str, generator: torch.Generator) -> Dense:
        """Return fresh synapses among the neurons of a layer."""
        neurons = self.config.layers[layer].neurons
        return Dense(neurons, neurons, generator, gain=0.5)

    def parameter_groups(self) -> Mapping[str, nn.Module]:
        """Return the layers by name."""
        return dict(self._circuit.layers)


class Network(LayeredNetwork):
    """The layers of its configuration, of which the last one sends the outputs."""

    def step(
        self, inputs: Mapping[str, Tensor], state: State, probe: Probe | None = None
    ) -> tuple[dict[str, Tensor], State]:
        """Run one window."""
        last = [*self.config.layers][-1]
        spikes, after = self.run_layers(inputs, state, [last], probe)
        return self._sent(spikes[last]), after

    def _sent(self, spikes: Tensor) -> dict[str, Tensor]:
        """Return the outputs, of the spikes of the last layer."""
        parts = spikes.split([port.channels for port in self.output_ports.values()], dim=-1)
        return dict(zip(self.output_ports, parts, strict=True))
