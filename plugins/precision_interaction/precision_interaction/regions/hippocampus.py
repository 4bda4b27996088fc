"""The hippocampus: a double-recurrent spiking network that expects the coming contact."""

from collections.abc import Mapping

import torch
from torch import Tensor, nn

from neurorobo.clock import Clock
from neurorobo.engine import Circuit, Layer
from neurorobo.neurons import LIF, Surrogate, spiking_neural_unit
from neurorobo.regions.region import Probe, Region, State
from neurorobo.synapses import Dense
from precision_interaction.regions.hippocampus_config import HippocampusConfig


class Hippocampus(Region):
    """Speed and feedback -> recurrent spiking neural units -> mean and variance (Sec. IV-B, Fig. 2).

    Nothing fires without input, so no speed means no contact. The state is the hidden layer's potential, which also
    says who fired last; the output neurons start every window at rest.

    With a `fixed` recurrence the hidden layer is the liquid of a liquid state machine (Maass et al. 2002): drawn once,
    and no part of what can be trained, but for the synapses that excite it.
    """

    config: HippocampusConfig

    def __init__(self, config: HippocampusConfig, clock: Clock, generator: torch.Generator) -> None:
        super().__init__(config, clock, generator)
        hidden, surrogate = config.hidden_neurons, Surrogate("arctan", config.surrogate_width)
        self.hidden = Layer(
            [
                Dense(port.channels, hidden, generator, gain=2.0 if name == "speed" else 1.0)
                for name, port in self.input_ports.items()
            ],
            spiking_neural_unit(surrogate=surrogate),
            recurrent=None if config.recurrence == "none" else Dense(hidden, hidden, generator, gain=0.5),
            trainable_threshold=config.recurrence != "fixed",
        )
        self._sizes = [port.channels for port in self.output_ports.values()]
        self.output = Layer([Dense(hidden, sum(self._sizes), generator)], LIF(surrogate=surrogate))
        self._circuit = Circuit(
            self.input_ports, {"hidden": (self.hidden, list(self.input_ports)), "output": (self.output, ["hidden"])}
        )

    def init_state(self, batch: int) -> State:
        """Return the potential of the hidden units at rest, (batch, hidden_neurons)."""
        return {"hidden": self.hidden.at_rest(batch)}

    def step(
        self, inputs: Mapping[str, Tensor], state: State, probe: Probe | None = None
    ) -> tuple[dict[str, Tensor], State]:
        """Look one period further ahead than the feedback does."""
        spikes, after = self._circuit(inputs, state, ["output"], probe)
        return dict(zip(self.output_ports, spikes["output"].split(self._sizes, dim=-1), strict=True)), after

    def parameter_groups(self) -> Mapping[str, nn.Module]:
        """Return `hidden` and `output`; with a fixed recurrence `input`, the synapses onto the liquid, and `output`."""
        if self.config.recurrence == "fixed":
            return {"input": self.hidden.projections, "output": self.output}
        return super().parameter_groups()
