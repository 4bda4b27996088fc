"""A layer of neurons, some of whose synapses learn."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from neurorobo.engine import Layer, run_neurons
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
        current, sources = sum(parts[1:], parts[0]), dict(inputs)
        recurrent = None if self.layer.recurrent is None else self.layer.recurrent.matrix()
        if recurrent is not None and RECURRENT in changes:
            recurrent = recurrent + changes[RECURRENT]  # from member to member another one
            spikes, after = self._run_steps(current, neurons, recurrent)
        else:
            spikes, after = self._scan(current.clone(), neurons, recurrent)  # its memory is given away
        spoken = spikes.detach()
        if recurrent is not None:
            sources[RECURRENT] = torch.cat([self.layer.fired(neurons).unsqueeze(0), spoken[:-1]])
            current = current + (recurrent @ sources[RECURRENT].unsqueeze(3)).squeeze(3)
        distance = self._distance(current, neurons, spoken) if self._needs_potential else None
        learned: State = {}
        for key, plastic in self.synapses.items():
            own = {name.removeprefix(f"{key}."): v for name, v in state.items() if name.startswith(f"{key}.")}
            activity = Activity(sources[key], spoken, self.step_ns, self.layer.neuron, distance)
            then = plastic.learn(self._projection(key).weight, activity, [told(rule) for rule in plastic.rules], own)
            learned |= {f"{key}.{name}": value for name, value in then.items()}
        return spikes, after, learned

    @property
    def _needs_potential(self) -> bool:
        return any(rule.needs_potential for plastic in self.synapses.values() for rule in plastic.rules)

    def _projection(self, key: str) -> Projection:
        found = self.layer.recurrent if key == RECURRENT else self.layer.projections[self.reads.index(key)]
        assert isinstance(found, Projection)
        return found

    def _threshold(self) -> Tensor | float:
        assert isinstance(self.layer.neuron, LIF)
        return self.layer.neuron.threshold if self.layer.threshold is None else self.layer.threshold

    def _scan(self, current: Tensor, neurons: Tensor, recurrent: Tensor | None) -> tuple[Tensor, Tensor]:
        return run_neurons(current, neurons, self.layer.neuron, self.layer.threshold, recurrent)

    def _run_steps(self, current: Tensor, neurons: Tensor, recurrent: Tensor) -> tuple[Tensor, Tensor]:
        """Run step by step with recurrent weights (batch, neurons, neurons)."""
        fired, is_lif, spikes = self.layer.fired(neurons), type(self.layer.neuron) is LIF, []
        if not is_lif:
            neurons = neurons[:, : -self.layer.neurons]
        for now in current.split(1):
            heard = (recurrent @ fired.unsqueeze(2)).squeeze(2)
            window, neurons = self._scan(now + heard, neurons, None)
            fired = window[0]
            spikes.append(window)
        return torch.cat(spikes), neurons if is_lif else torch.cat([neurons, fired], dim=1)

    @torch.no_grad()
    def _distance(self, current: Tensor, potential: Tensor, spikes: Tensor) -> Tensor:
        """Return how far the potentials of LIF neurons were above their thresholds (steps, batch, neurons).

        ``current`` is all that they heard, ``potential`` (batch, neurons) that before the window.
        """
        assert isinstance(self.layer.neuron, LIF)
        before = torch.cat([self.layer.fired(potential).unsqueeze(0), spikes[:-1]])
        potentials = []
        for now, left in zip(current, self.layer.neuron.decay * (1 - before), strict=True):
            potential = torch.addcmul(now, potential, left)
            potentials.append(potential)
        return torch.stack(potentials) - self._threshold()
