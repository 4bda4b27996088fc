"""Tiny regions for testing graphs: their results can be computed by hand."""

from collections.abc import Mapping
from typing import ClassVar, Literal

import torch
from torch import Tensor

from neurorobo.clock import Clock
from neurorobo.codes import PopulationUniform
from neurorobo.regions import Port, RegionConfig
from neurorobo.regions.region import Probe, Region, State


class AddConfig(RegionConfig):
    """sum = a + b, b from the state if it is not wired."""

    implementation: ClassVar[str] = "tests.graph.toys:Add"
    type: Literal["toy.add"] = "toy.add"
    amount: float = 1.0
    unit: str = "mN"

    def inputs(self, clock: Clock) -> dict[str, Port]:
        return {"a": Port(self.unit, initial=(0.0,)), "b": Port(self.unit, initial=(self.amount,))}

    def outputs(self, clock: Clock) -> dict[str, Port]:
        return {"sum": Port(self.unit)}


class Add(Region):
    """Adds its inputs."""

    def step(
        self, inputs: Mapping[str, Tensor], state: State, probe: Probe | None = None
    ) -> tuple[dict[str, Tensor], State]:
        return {"sum": inputs["a"] + inputs["b"]}, state


class CountConfig(RegionConfig):
    """Counts its uses; how long it remembers is up to `carry`."""

    implementation: ClassVar[str] = "tests.graph.toys:Count"
    type: Literal["toy.count"] = "toy.count"

    def inputs(self, clock: Clock) -> dict[str, Port]:
        return {"a": Port("mN", initial=(0.0,))}

    def outputs(self, clock: Clock) -> dict[str, Port]:
        return {"count": Port("mN")}


class Count(Region):
    """Counts its uses in its state."""

    def init_state(self, batch: int) -> State:
        return {"count": torch.zeros(batch, 1)}

    def step(
        self, inputs: Mapping[str, Tensor], state: State, probe: Probe | None = None
    ) -> tuple[dict[str, Tensor], State]:
        count = state["count"] + 1
        return {"count": count}, {"count": count}


class SpikingRelayConfig(RegionConfig):
    """Passes spikes on; its neurons and range are settings."""

    implementation: ClassVar[str] = "tests.graph.toys:SpikingRelay"
    type: Literal["toy.relay"] = "toy.relay"
    neurons: int = 4
    hi: float = 100.0
    unit: str = "mN"

    def inputs(self, clock: Clock) -> dict[str, Port]:
        return {"a": Port(self.unit, code=PopulationUniform(self.neurons, 0.0, self.hi), initial=(10.0,))}

    def outputs(self, clock: Clock) -> dict[str, Port]:
        return {"same": Port(self.unit, code=PopulationUniform(self.neurons, 0.0, self.hi))}


class SpikingRelay(Region):
    """Passes spikes on."""

    def step(
        self, inputs: Mapping[str, Tensor], state: State, probe: Probe | None = None
    ) -> tuple[dict[str, Tensor], State]:
        if probe is not None:
            probe("relay", inputs["a"])
        return {"same": inputs["a"]}, state


class TallyConfig(RegionConfig):
    """sum = a / 2 + the number of the use: every use says something else."""

    implementation: ClassVar[str] = "tests.graph.toys:Tally"
    type: Literal["toy.tally"] = "toy.tally"

    def inputs(self, clock: Clock) -> dict[str, Port]:
        return {"a": Port("mN", initial=(0.25,))}

    def outputs(self, clock: Clock) -> dict[str, Port]:
        return {"sum": Port("mN")}


class Tally(Region):
    """Counts its uses in its state, and adds what it hears."""

    def init_state(self, batch: int) -> State:
        return {"count": torch.zeros(batch, 1)}

    def step(
        self, inputs: Mapping[str, Tensor], state: State, probe: Probe | None = None
    ) -> tuple[dict[str, Tensor], State]:
        count = state["count"] + 1
        return {"sum": inputs["a"] / 2 + count}, {"count": count}
