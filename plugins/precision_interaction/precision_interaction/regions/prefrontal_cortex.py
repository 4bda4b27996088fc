"""The prefrontal cortex: a block-based spiking network that plans the axial speed."""

from collections.abc import Mapping
from itertools import pairwise

import torch
from torch import Tensor, nn

from neurorobo.clock import Clock
from neurorobo.engine import Circuit, Layer
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

    def value(self, fired: Tensor) -> Tensor:
        """Spikes (steps, batch, neurons) -> what they say (batch, 1)."""
        return (fired.mean(0) @ self.weight).unsqueeze(1)


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
        later = [Layer([Dense(before, after, generator, gain=1.5)], NEURON) for before, after in pairwise(sizes)]
        self.later = nn.ModuleList(later)
        names = [*(f"layer_{number}" for number in range(3, len(later) + 2)), "output"]
        reads = [("prediction", "terminal", "general"), *names]
        self._circuit = Circuit(
            self.input_ports,
            {
                "prediction": (self.prediction.layer, [("forecast", "variance")]),
                "terminal": (self.terminal.layer, [("remaining", "speed")]),
                "general": (self.general, [tuple(self.input_ports)]),
                **{name: (layer, [read]) for name, layer, read in zip(names, later, reads, strict=False)},
            },
        )

    def step(
        self, inputs: Mapping[str, Tensor], state: State, probe: Probe | None = None
    ) -> tuple[dict[str, Tensor], State]:
        """Plan one axial period."""
        spikes, _ = self._circuit(inputs, wanted=["prediction", "terminal", "output"], probe=probe)
        speed, beta = spikes["output"].split(self.config.output_neurons, dim=-1)
        return {
            "speed": speed,
            "beta": beta,
            "confidence": self.prediction.value(spikes["prediction"]),
            "terminal": self.terminal.value(spikes["terminal"]),
        }, state
