"""A hippocampus that re-estimates the contact law from what is felt."""

from collections.abc import Mapping
from typing import ClassVar

import torch
from torch import Tensor

from neurorobo.clock import Clock
from neurorobo.engine import Circuit
from neurorobo.regions.driven import run_driven
from neurorobo.regions.plastic import Plastic
from neurorobo.regions.region import Probe, State
from neurorobo.regions.weights import to_grid
from neurorobo.synapses.plasticity import error_driven
from precision_interaction.regions.adaptive_hippocampus_config import AdaptiveHippocampusConfig
from precision_interaction.regions.hippocampus import Hippocampus

FEEDBACK = ("mean_feedback", "variance_feedback")
BITS = 14
"""Learned currents are multiples of 2**-14: their sums are exact, and spikes do not depend on the batch."""


class AdaptiveHippocampus(Plastic):
    """The hippocampus, with plastic synapses from the hidden units onto the output neurons.

    The neurons of one output component have the same plastic synapses, which start at 0 and follow the delta rule: in
    proportion to the error of the component, and to what the hidden units did when it was expected. One lesson is
    normalised by the spikes that it is learned from (Nagumo & Noda 1967), so that a rate of 1 would take about all of
    the error away. No spike, no change: at speed 0 nothing is ever expected.

    State: `hidden` is the potential of the hidden units, `synapses` (batch, components, hidden) the plastic ones,
    `trace` (batch, hidden) the spikes of the last window.
    """

    config: AdaptiveHippocampusConfig
    learned: ClassVar[tuple[str, ...]] = ("synapses",)

    def __init__(self, config: AdaptiveHippocampusConfig, clock: Clock, generator: torch.Generator) -> None:
        super().__init__(config, clock, generator)
        plain = Hippocampus(config.plain(), clock, generator)
        self.hidden, self.output = plain.hidden, plain.output
        self._before = Circuit(plain.input_ports, {"hidden": (self.hidden, list(plain.input_ports))})
        self._sizes = [port.channels for port in self.output_ports.values()]

    def init_state(self, batch: int) -> State:
        """Return the state at rest, before learning."""
        hidden, components = self.config.hidden_neurons, sum(port.width for port in self.output_ports.values())
        return {
            "hidden": self.hidden.at_rest(batch),
            "synapses": torch.zeros(batch, components, hidden),
            "trace": torch.zeros(batch, hidden),
        }

    def step(
        self, inputs: Mapping[str, Tensor], state: State, probe: Probe | None = None
    ) -> tuple[dict[str, Tensor], State]:
        """Learn from the window before, then look one period further ahead than the feedback does."""
        synapses = self._taught(inputs, state)
        goes_on = torch.stack([inputs[name].amax((0, 2)) for name in FEEDBACK]).amax(0) > 0
        before = {"hidden": torch.where(goes_on.unsqueeze(1), state["hidden"], 0.0)}
        spikes, after = self._before(inputs, before, ["hidden"], probe)
        hidden = spikes["hidden"]
        by_component = torch.einsum("tbh,bch->tbc", hidden, to_grid(synapses, BITS))
        facilitation = (torch.arange(len(hidden)) + 0.5) * (2 / len(hidden))
        current = to_grid(by_component * facilitation[:, None, None], BITS)
        current = current.repeat_interleave(self.config.output_neurons, dim=2)
        output = run_driven(self.output, [hidden], current)
        if probe is not None:
            probe("output", output)
        outputs = dict(zip(self.output_ports, output.split(self._sizes, dim=-1), strict=True))
        return outputs, {**after, "synapses": synapses, "trace": hidden.sum(0)}

    def _taught(self, inputs: Mapping[str, Tensor], state: State) -> Tensor:
        """Return the synapses, changed by how wrong the window before was."""
        lessons = []
        for name, rate in (("mean", self.config.learning_rate), ("variance", self.config.variance_learning_rate)):
            code = self.output_ports[name].code
            assert code is not None
            value_of_a_volley = (code.hi - code.lo) / self.clock.window  # one spike of every neuron of the component
            lessons.append(rate * self.output.neuron.threshold / value_of_a_volley * inputs[f"{name}_error"])  # type: ignore[attr-defined]
        error = torch.cat(lessons, dim=1)
        if not error.any():
            return state["synapses"]
        trace = state["trace"]
        share = trace / (trace**2).sum(1, keepdim=True).clamp(min=1)
        return error_driven(state["synapses"], share, error, 1.0)
