"""The prefrontal cortex: a block-based spiking network that plans the axial speed."""

from collections.abc import Mapping
from itertools import pairwise

import torch
from torch import Tensor, nn

from neurorobo.clock import Clock
from neurorobo.engine import Layer
from neurorobo.neurons import LIF, Surrogate
from neurorobo.regions.region import Probe, Region, State
from neurorobo.synapses import Dense
from precision_interaction.regions.prefrontal_cortex_config import PrefrontalCortexConfig

NEURON = LIF(surrogate=Surrogate("arctan", 1.0))  # its tails let a silent output neuron recover


class Block(nn.Module):
    """Isolated neurons that read some of the inputs, and a weighted sum of their rates that says what they know."""

    def __init__(self, sources: int, neurons: int, generator: torch.Generator) -> None:
        super().__init__()
        self.layer = Layer([Dense(sources, neurons, generator, gain=3.0)], NEURON)
        self.weight = nn.Parameter(torch.randn(neurons, generator=generator) / neurons**0.5)

    def forward(self, spikes: Tensor) -> tuple[Tensor, Tensor]:
        """Spikes (steps, batch, sources) -> the block's spikes (steps, batch, neurons) and its value (batch, 1)."""
        fired = _feed(self.layer, spikes)
        return fired, (fired.mean(0) @ self.weight).unsqueeze(1)


class PrefrontalCortex(Region):
    """Two blocks and a general part side by side, then dense layers down to speed and beta (Sec. IV-D, Fig. 4).

    Every layer starts each window at rest. The blocks' values are for teaching (Eq. 11) and watching them; what comes
    after reads their spikes. Parameter groups: prediction, terminal, general, and later (the layers after the second).
    """

    config: PrefrontalCortexConfig

    def __init__(self, config: PrefrontalCortexConfig, clock: Clock, generator: torch.Generator) -> None:
        super().__init__(config, clock, generator)
        channels = {name: port.channels for name, port in self.input_ports.items()}
        self.prediction = Block(channels["forecast"] + channels["variance"], config.prediction_neurons, generator)
        self.terminal = Block(channels["remaining"] + channels["speed"], config.terminal_neurons, generator)
        self.general = Layer([Dense(sum(channels.values()), config.general_neurons, generator, gain=1.5)], NEURON)
        second = config.prediction_neurons + config.terminal_neurons + config.general_neurons
        sizes = (second, *config.hidden_neurons, 2 * config.output_neurons)
        self.later = nn.ModuleList(
            Layer([Dense(before, after, generator, gain=1.5)], NEURON) for before, after in pairwise(sizes)
        )

    def step(
        self, inputs: Mapping[str, Tensor], state: State, probe: Probe | None = None
    ) -> tuple[dict[str, Tensor], State]:
        """Plan one axial period."""
        predicting, confidence = self.prediction(torch.cat([inputs["forecast"], inputs["variance"]], dim=-1))
        ending, terminal = self.terminal(torch.cat([inputs["remaining"], inputs["speed"]], dim=-1))
        general = _feed(self.general, torch.cat([inputs[name] for name in self.input_ports], dim=-1))
        spikes = torch.cat([predicting, ending, general], dim=-1)
        if probe is not None:
            probe("second", spikes)
        for number, layer in enumerate(self.later, start=3):
            spikes = _feed(layer, spikes)
            if probe is not None:
                probe("output" if number == len(self.later) + 2 else f"layer_{number}", spikes)
        speed, beta = spikes.split(self.config.output_neurons, dim=-1)
        return {"speed": speed, "beta": beta, "confidence": confidence, "terminal": terminal}, state


def _feed(layer: nn.Module, spikes: Tensor) -> Tensor:
    """Run one window of a layer from rest."""
    fired: Tensor = layer([spikes])[0]
    return fired
