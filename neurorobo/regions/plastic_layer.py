"""A layer of neurons, some of whose synapses learn."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from neurorobo.engine import Layer, run_steps, run_window
from neurorobo.neurons import LIF
from neurorobo.plasticity import Activity, LearningRule
from neurorobo.plasticity.synapses import CHANGE, PlasticSynapses
from neurorobo.regions.plastic_network_config import RECURRENT
from neurorobo.regions.region import State
from neurorobo.regions.weights import to_grid
from neurorobo.synapses import Projection

BITS = 14
"""What has been learned counts in multiples of 2**-14: sums are exact, and spikes do not depend on the batch."""

Told = Callable[[LearningRule], Tensor | None]
"""What the modulator of a rule, if it has one, tells each target in this window: (batch, targets) or (batch, 1)."""


@dataclass(frozen=True)
class PlasticLayer:
    """A layer, what each of its projections reads, and those synapses that learn, by what they read or `recurrent`.

    Their state, under ``source.name``, is kept apart from that of the neurons.
    """

    layer: Layer
    reads: Sequence[str]
    synapses: Mapping[str, PlasticSynapses]
    step_ns: int

    def init_state(self, batch: int) -> State:
        """Return the state of the synapses before learning."""
        state: State = {}
        for key, plastic in self.synapses.items():
            projection = self._projection(key)
            began = plastic.init_state(batch, projection.weight.detach(), projection.sources)
            state |= {f"{key}.{name}": value for name, value in began.items()}
        return state

    def run(
        self, inputs: Mapping[str, Tensor], neurons: Tensor, state: State, told: Told
    ) -> tuple[Tensor, Tensor, State]:
        """Run a window with what was learned before it, then learn: the spikes, and both states behind it.

        ``inputs`` are the spikes (steps, batch, sources) of each of ``reads``, ``neurons`` is the neurons' state.
        """
        changes = {key: to_grid(state[f"{key}.{CHANGE}"], BITS) for key in self.synapses}
        parts = [projection(inputs[read]) for projection, read in zip(self.layer.projections, self.reads, strict=True)]
        parts += [self.synapses[key].currents(inputs[key], changes[key]) for key in changes if key != RECURRENT]
        current = sum(parts[1:], parts[0])
        before = self._fired(neurons)
        if RECURRENT in changes or self._needs_potential:
            spikes, neurons, distance = self._run_steps(current, neurons, before, changes.get(RECURRENT))
        else:
            recurrent = self.layer.recurrent
            spikes, neurons = self._scan(current, neurons, None if recurrent is None else recurrent.matrix())
            distance = None
        sources = {**inputs, RECURRENT: torch.cat([before.unsqueeze(0), spikes[:-1]])}
        after: State = {}
        for key, plastic in self.synapses.items():
            own = {name.removeprefix(f"{key}."): v for name, v in state.items() if name.startswith(f"{key}.")}
            activity = Activity(sources[key], spikes.detach(), self.step_ns, self.layer.neuron, distance)
            modulators = [told(rule) for rule in plastic.rules]
            learned = plastic.learn(self._projection(key).weight, activity, modulators, own)
            after |= {f"{key}.{name}": value for name, value in learned.items()}
        return spikes, neurons, after

    @property
    def _needs_potential(self) -> bool:
        return any(rule.needs_potential for plastic in self.synapses.values() for rule in plastic.rules)

    def _projection(self, key: str) -> Projection:
        found = self.layer.recurrent if key == RECURRENT else self.layer.projections[self.reads.index(key)]
        assert isinstance(found, Projection)
        return found

    def _fired(self, neurons: Tensor) -> Tensor:
        """Return the last spikes (batch, neurons) before a window; zeros where nothing asks for them."""
        if self.layer.recurrent is None:
            return neurons.new_zeros(len(neurons), self.layer.neurons)
        if type(self.layer.neuron) is LIF:
            return (neurons >= self._threshold).to(neurons.dtype)
        return neurons[:, -self.layer.neurons :]

    @property
    def _threshold(self) -> Tensor | float:
        assert isinstance(self.layer.neuron, LIF)
        return self.layer.neuron.threshold if self.layer.threshold is None else self.layer.threshold

    def _scan(self, current: Tensor, neurons: Tensor, recurrent: Tensor | None) -> tuple[Tensor, Tensor]:
        neuron = self.layer.neuron
        if type(neuron) is LIF:
            return run_window(current, neurons, neuron, self.layer.threshold, recurrent)
        return run_steps(current, neurons, neuron, recurrent)

    def _run_steps(
        self, current: Tensor, neurons: Tensor, fired: Tensor, change: Tensor | None
    ) -> tuple[Tensor, Tensor, Tensor | None]:
        """Run step by step: what neurons hear from one another may differ from member to member."""
        is_lif, recurrent = type(self.layer.neuron) is LIF, self.layer.recurrent
        if recurrent is not None and not is_lif:
            neurons = neurons[:, : -self.layer.neurons]
        spikes, distances = [], []
        for now in current.unbind():
            if recurrent is not None:
                now = now + recurrent(fired)
            if change is not None:
                now = now + torch.einsum("bs,bns->bn", fired, change)
            window, neurons = self._scan(now.unsqueeze(0).clone(), neurons, None)
            fired = window[0]
            spikes.append(fired)
            if is_lif:
                distances.append(neurons.detach() - self._threshold)
        if recurrent is not None and not is_lif:
            neurons = torch.cat([neurons, fired], dim=1)
        return torch.stack(spikes), neurons, torch.stack(distances) if distances else None
