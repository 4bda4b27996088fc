"""A network whose synapses learn by local rules while it runs."""

import math
from collections.abc import Mapping
from functools import partial
from typing import ClassVar

import torch
from torch import Tensor

from neurorobo.clock import Clock
from neurorobo.plasticity import LearningRule, ModulatedRule
from neurorobo.plasticity.synapses import CHANGE, PlasticSynapses
from neurorobo.regions.plastic import Plastic
from neurorobo.regions.plastic_layer import PlasticLayer
from neurorobo.regions.plastic_network_config import RECURRENT, PlasticNetworkConfig, SynapsesConfig
from neurorobo.regions.region import Probe, State
from neurorobo.regions.spiking_network import ALWAYS, Network
from neurorobo.regions.spiking_network_config import INPUTS
from neurorobo.synapses import Dense, FanIn, Projection


class PlasticNetwork(Network, Plastic):
    """The layers of its configuration, some of whose synapses learn; a window runs with what was learned before it.

    State: that of the neurons of each layer, under its name, and of synapses that learn, under ``layer.source.name``,
    what :class:`neurorobo.plasticity.synapses.PlasticSynapses` says; ``mean.modulator`` (batch, width) is what is taken
    off a modulator that has a baseline.
    """

    config: PlasticNetworkConfig
    learned: ClassVar[tuple[str, ...]] = ()

    def __init__(self, config: PlasticNetworkConfig, clock: Clock, generator: torch.Generator) -> None:
        super().__init__(config, clock, generator)
        plastic = {name: self._plastic_layer(name) for name in config.layers}
        self._plastic = {name: layer for name, layer in plastic.items() if layer.synapses}
        self.learned = tuple(  # type: ignore[misc]  # what it is hangs on the configuration
            f"{name}.{key}.{CHANGE}" for name, layer in self._plastic.items() for key in layer.synapses
        )
        for name, _, synapses in config.synapses():
            for rule in synapses.learns:
                if isinstance(rule, ModulatedRule) and rule.modulator and rule.feedback == "random":
                    shape = config.layers[name].neurons, config.modulators[rule.modulator].width
                    if not hasattr(self, feedback := _feedback(name, rule.modulator)):
                        self.register_buffer(feedback, torch.randn(shape, generator=generator) / shape[1] ** 0.5)

    def init_state(self, batch: int) -> State:
        """Return the states of all layers at rest, before learning."""
        state = super().init_state(batch)
        for name, layer in self._plastic.items():
            state |= {f"{name}.{key}": value for key, value in layer.init_state(batch).items()}
        for name, modulator in self.config.modulators.items():
            if modulator.baseline is not None:
                initial = torch.tensor(self.input_ports[name].initial or (0.0,) * modulator.width)
                state[_mean(name)] = initial.repeat(batch, 1)
        return state

    def step(
        self, inputs: Mapping[str, Tensor], state: State, probe: Probe | None = None
    ) -> tuple[dict[str, Tensor], State]:
        """Run one window, then learn from it."""
        known = {name: inputs[name] for name in self.config.receives}
        some = next(iter(known.values()))
        known |= {INPUTS: torch.cat([*known.values()], dim=-1), ALWAYS: some.new_ones((*some.shape[:2], 1))}
        modulators, after = self._modulators(inputs, state)
        spikes = some
        for name, layer in self._circuit.layers.items():
            reads = self._reads(name)
            if (plastic := self._plastic.get(name)) is None:
                spikes, after[name] = layer([known[read] for read in reads], state[name])
            else:
                own = {k.removeprefix(f"{name}."): v for k, v in state.items() if k.startswith(f"{name}.")}
                told = partial(self._told, name, modulators)
                spikes, after[name], learned = plastic.run({r: known[r] for r in reads}, state[name], own, told)
                after |= {f"{name}.{key}": value for key, value in learned.items()}
            known[name] = spikes
            if probe is not None:
                probe(name, spikes)
        return self._sent(spikes), after

    def _reads(self, name: str) -> list[str]:
        """Return what each projection of a layer reads."""
        layer = self.config.layers[name]
        return [*layer.reads, *([ALWAYS] if layer.bias else [])]

    def _plastic_layer(self, name: str) -> PlasticLayer:
        layer, reads = self._circuit.layers[name], self._reads(name)
        synapses = {}
        for key, settings in self.config.layers[name].synapses.items():
            if settings.learns and settings.bounds is not None:
                projection = layer.recurrent if key == RECURRENT else layer.projections[reads.index(key)]
                index = projection.source_index if isinstance(projection, FanIn) else None
                synapses[key] = PlasticSynapses(settings.learns, settings.bounds, index)
        return PlasticLayer(layer, reads, synapses, self.clock.spike_step_ns)

    def _modulators(self, inputs: Mapping[str, Tensor], state: State) -> tuple[dict[str, Tensor], State]:
        """Return the modulators without their means, where these are taken, and the means behind this window."""
        told, means = {name: inputs[name] for name in self.config.modulators}, State()
        for name, modulator in self.config.modulators.items():
            if modulator.baseline is not None:
                told[name] = told[name] - state[_mean(name)]
                share = -math.expm1(-self.clock.window_ns / modulator.baseline)
                means[_mean(name)] = state[_mean(name)] + share * told[name]
        return told, means

    def _told(self, layer: str, modulators: Mapping[str, Tensor], rule: LearningRule) -> Tensor | None:
        """Return what its modulator tells the neurons of a layer, (batch, neurons) or (batch, 1), if it has one."""
        if not isinstance(rule, ModulatedRule) or rule.modulator is None:
            return None
        modulator = modulators[rule.modulator]
        if rule.feedback == "random":
            return (modulator.unsqueeze(1) * self.get_buffer(_feedback(layer, rule.modulator))).sum(2)
        if modulator.shape[1] == 1:
            return modulator
        return modulator.repeat_interleave(self.config.layers[layer].neurons // modulator.shape[1], dim=1)

    def _projection(self, layer: str, read: str, sources: int, generator: torch.Generator) -> Projection:
        settings, neurons = self._settings(layer, read), self.config.layers[layer].neurons
        gain = self.config.gain if settings.gain is None else settings.gain
        if settings.fan_in is None:
            return Dense(sources, neurons, generator, gain=gain, sign=settings.sign)
        return FanIn(sources, neurons, settings.fan_in, generator, gain=gain, sign=settings.sign)

    def _recurrent(self, layer: str, generator: torch.Generator) -> Dense:
        neurons, settings = self.config.layers[layer].neurons, self._settings(layer, RECURRENT)
        gain = 0.5 if settings.gain is None else settings.gain
        return Dense(neurons, neurons, generator, gain=gain, sign=settings.sign)

    def _settings(self, layer: str, key: str) -> SynapsesConfig:
        return self.config.layers[layer].synapses.get(key, SynapsesConfig())


def _mean(modulator: str) -> str:
    """Return the name in the state of a modulator's running mean."""
    return f"mean.{modulator}"


def _feedback(layer: str, modulator: str) -> str:
    """Return the name of the fixed random weights from a modulator to a layer."""
    return f"feedback:{layer}:{modulator}"
