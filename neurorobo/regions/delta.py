"""Send on delta: a region that tells in spikes what changes, and one that adds it up again.

Source: send-on-delta sampling (Miskowicz 2006), which each pixel of the Dynamic Vision Sensor does (Lichtsteiner et al.
2008), a delta modulator with three levels.
"""

from collections.abc import Mapping

import torch
from torch import Tensor

from neurorobo.clock import Clock
from neurorobo.codes.population_signed import PopulationSigned
from neurorobo.regions.delta_config import DeltaEncoderConfig
from neurorobo.regions.region import Probe, Region, State


class DeltaEncoder(Region):
    """An ON or OFF spike for each ``threshold`` that the quantity has gone from what was told of it before.

    What was told (batch, width) is its state, zero at first. After each window it is less than a threshold from the
    quantity, unless that had gone further than one threshold for each step of the window, the most that can be told:
    then the rest follows in later windows.
    """

    def __init__(self, config: DeltaEncoderConfig, clock: Clock, generator: torch.Generator) -> None:
        super().__init__(config, clock, generator)
        code = self.output_ports["change"].code
        assert isinstance(code, PopulationSigned)
        self._code = code

    def init_state(self, batch: int) -> State:
        """Nothing has been told."""
        return {"told": torch.zeros(batch, self.input_ports["value"].width)}

    def step(
        self, inputs: Mapping[str, Tensor], state: State, probe: Probe | None = None
    ) -> tuple[dict[str, Tensor], State]:
        """Tell what has changed; numbers (batch, width) -> spikes (steps, batch, 2 * width)."""
        steps = self.clock.window
        threshold = self._code.resolution(steps)
        passed = ((inputs["value"] - state["told"]) / threshold).trunc() * threshold
        spikes = self._code.encode(passed, steps)
        if probe is not None:
            probe("change", spikes)
        return {"change": spikes}, {"told": state["told"] + self._code.decode(spikes)}


class DeltaDecoder(Region):
    """``value = value + change``: equal, to the last bit, to what the encoder knows that it has told."""

    def init_state(self, batch: int) -> State:
        """Nothing has been heard."""
        return {"value": torch.zeros(batch, self.input_ports["change"].width)}

    def step(
        self, inputs: Mapping[str, Tensor], state: State, probe: Probe | None = None
    ) -> tuple[dict[str, Tensor], State]:
        """Add the change, numbers (batch, width)."""
        value = state["value"] + inputs["change"]
        return {"value": value}, {"value": value}
