"""The spiking cerebellum: mossy fibres to granule cells to Purkinje cells to deep nuclei to an output layer."""

from collections.abc import Mapping

import torch
from torch import Tensor

from neurorobo.clock import Clock
from neurorobo.engine import Circuit, Layer
from neurorobo.neurons import LIF, Surrogate
from neurorobo.regions.region import Probe, Region, State
from neurorobo.synapses import Dense, FanIn
from precision_interaction.regions.cerebellum_config import CerebellumConfig

INPUTS = ("velocity", "force", "mean", "variance")


class Cerebellum(Region):
    """Radial force, velocity and expected contact -> the radial move and the force it leaves.

    Purkinje cells inhibit the deep nuclei, mossy fibres excite them; training keeps both signs. All that comes out has
    passed the nuclei. Every window starts at rest. Source: Sec. III-C and Fig. 3 of Xing et al.
    """

    config: CerebellumConfig

    def __init__(self, config: CerebellumConfig, clock: Clock, generator: torch.Generator) -> None:
        super().__init__(config, clock, generator)
        fibres = sum(self.input_ports[name].channels for name in INPUTS)
        components = 6 if config.own_velocity else 4  # x, y of move and residual, and of a velocity of its own
        neuron = LIF(surrogate=Surrogate("triangular", 1.0))
        # The gains let every layer fire at 0.1 to 0.4 before training.
        self.granule = Layer([FanIn(fibres, config.granule_cells, config.granule_fan_in, generator, gain=1.05)], neuron)
        self.purkinje = Layer([Dense(config.granule_cells, config.purkinje_cells, generator, gain=1.4)], neuron)
        self.nuclei = Layer(
            [
                Dense(config.purkinje_cells, config.nuclei, generator, gain=0.16, sign="inhibitory"),
                Dense(fibres, config.nuclei, generator, gain=0.5, sign="excitatory"),
            ],
            neuron,
        )
        readout = Dense(config.nuclei, components * config.output_neurons, generator, gain=0.2)
        _give_each_output_its_nuclei(readout.weight, components, config)
        self.output = Layer([readout], neuron)
        self._circuit = Circuit(
            INPUTS,
            {
                "granule": (self.granule, [INPUTS]),
                "purkinje": (self.purkinje, ["granule"]),
                "nuclei": (self.nuclei, ["purkinje", INPUTS]),
                "output": (self.output, ["nuclei"]),
            },
        )

    def step(
        self, inputs: Mapping[str, Tensor], state: State, probe: Probe | None = None
    ) -> tuple[dict[str, Tensor], State]:
        """Run one window from rest."""
        spikes, _ = self._circuit(inputs, wanted=["output"], probe=probe)
        move, residual, *own = spikes["output"].split(2 * self.config.output_neurons, dim=-1)
        return {"move": move, "residual": residual, "velocity": own[0] if own else move}, state


@torch.no_grad()
def _give_each_output_its_nuclei(weight: Tensor, components: int, config: CerebellumConfig) -> None:
    """Let each output component start from a share of the nuclei, read with graded weights; training mixes them."""
    share = config.nuclei // components
    grade = torch.linspace(0.45, 0.05, config.output_neurons)
    for output in range(components):
        rows = weight[output * config.output_neurons : (output + 1) * config.output_neurons]
        for nucleus in range(share):
            sign = 1 if nucleus % 2 == 0 else -1
            rows[:, output * share + nucleus] += (0.35 + sign * grade) * min(1.0, 2.0 / share)
