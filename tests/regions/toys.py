"""A small spiking region with everything that regions have: fixed sources, signs, recurrence, thresholds, state."""

from collections.abc import Mapping
from typing import ClassVar, Literal

import torch
from torch import Tensor

from neurorobo.clock import Clock
from neurorobo.codes import PopulationUniform
from neurorobo.engine import Layer
from neurorobo.neurons import LIF
from neurorobo.regions import Port, RegionConfig
from neurorobo.regions.region import Probe, Region, State
from neurorobo.synapses import Dense, FanIn

MS = 1_000_000
CLOCK = Clock({"control": 1000 * MS}, MS, 20)


class NetConfig(RegionConfig):
    """Two layers between two codes."""

    implementation: ClassVar[str] = "tests.regions.toys:Net"
    type: Literal["toy.net"] = "toy.net"
    neurons: int = 6
    hidden: int = 10

    def inputs(self, clock: Clock) -> dict[str, Port]:
        return {"force": Port("mN", 2, PopulationUniform(self.neurons, -1.0, 1.0), initial=(0.0, 0.0))}

    def outputs(self, clock: Clock) -> dict[str, Port]:
        return {"move": Port("um", code=PopulationUniform(self.neurons, 0.0, 4.0))}


class Net(Region):
    """Fan-in, recurrence, inhibition."""

    def __init__(self, config: NetConfig, clock: Clock, generator: torch.Generator) -> None:
        super().__init__(config, clock, generator)
        self.hidden = Layer(
            [FanIn(2 * config.neurons, config.hidden, 3, generator, gain=1.5, sign="excitatory")],
            LIF(),
            Dense(config.hidden, config.hidden, generator),
            trainable_threshold=True,
        )
        self.output = Layer(
            [
                Dense(config.hidden, config.neurons, generator, gain=0.5, sign="inhibitory"),
                Dense(2 * config.neurons, config.neurons, generator, gain=1.5, sign="excitatory"),
            ],
            LIF(),
        )

    def init_state(self, batch: int) -> State:
        return {"hidden": self.hidden.at_rest(batch), "output": self.output.at_rest(batch)}

    def step(
        self, inputs: Mapping[str, Tensor], state: State, probe: Probe | None = None
    ) -> tuple[dict[str, Tensor], State]:
        hidden, hidden_potential = self.hidden([inputs["force"]], state["hidden"])
        output, output_potential = self.output([hidden, inputs["force"]], state["output"])
        if probe is not None:
            probe("hidden", hidden)
            probe("output", output)
        return {"move": output}, {"hidden": hidden_potential, "output": output_potential}


def net(seed: int = 0, config: NetConfig | None = None) -> Net:
    return Net(config or NetConfig(), CLOCK, torch.Generator().manual_seed(seed))
