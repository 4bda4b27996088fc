"""Regions to be counted."""

from collections.abc import Mapping
from typing import ClassVar, Literal

import torch
from torch import Tensor, nn

from neurorobo.clock import Clock
from neurorobo.regions import Port, RegionConfig
from neurorobo.regions.region import Probe, Region, State
from tests.regions.toys import CLOCK


class AnalogueConfig(RegionConfig):
    """From three numbers to two."""

    implementation: ClassVar[str] = "tests.measures.toys:Analogue"
    type: Literal["toy.analogue"] = "toy.analogue"

    def inputs(self, clock: Clock) -> dict[str, Port]:
        return {"x": Port("1", 3)}

    def outputs(self, clock: Clock) -> dict[str, Port]:
        return {"y": Port("1", 2)}


class Analogue(Region):
    """A matrix with one zero, a bias, and a scale that is no part of a matrix."""

    def __init__(self) -> None:
        super().__init__(AnalogueConfig(), CLOCK, torch.Generator())
        self.linear = nn.Linear(3, 2)
        self.linear.weight.data = torch.tensor([[1.0, 2.0, 3.0], [0.0, 5.0, 6.0]])
        self.scale = nn.Parameter(torch.ones(2))

    def step(
        self, inputs: Mapping[str, Tensor], state: State, probe: Probe | None = None
    ) -> tuple[dict[str, Tensor], State]:
        return {"y": self.scale * self.linear(inputs["x"])}, state
