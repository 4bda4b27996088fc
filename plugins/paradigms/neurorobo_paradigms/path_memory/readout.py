"""A linear read-out that learns by recursive least squares while it runs.

Source: recursive least squares as FORCE learning has it (Sussillo & Abbott 2009), without the feedback.
"""

import math
from collections.abc import Mapping
from typing import ClassVar

import torch
from torch import Tensor

from neurorobo.clock import Clock
from neurorobo.regions.plastic import Plastic
from neurorobo.regions.region import Probe, State
from neurorobo_paradigms.path_memory.readout_config import LeastSquaresReadoutConfig


class LeastSquaresReadout(Plastic):
    """``said = middle + w x``, where x are the spikes of each source, filtered, at the end of the window.

    An error tells what should have been said beyond what was, at the end of the window before, whose x is remembered:

        k = P x / (1 + x P x);  w = w + error k;  P = P - k (P x)

    with w = 0 and P = 1 / ridge at the start. P, and with it each change, hangs on all sources: the rule is not local.
    An error of exactly 0 in all components changes nothing.

    State: `filtered` (batch, sources), what is learned, `weight` (batch, components, sources) and `inverse` (batch,
    sources, sources), in double precision.
    """

    config: LeastSquaresReadoutConfig
    learned: ClassVar[tuple[str, ...]] = ("weight", "inverse")

    def __init__(self, config: LeastSquaresReadoutConfig, clock: Clock, generator: torch.Generator) -> None:
        """There is nothing to draw."""
        super().__init__(config, clock, generator)
        self._sources = sum(self.input_ports[name].channels for name in config.receives)
        self._kept = math.exp(-clock.spike_step_ns / config.filter)

    def init_state(self, batch: int) -> State:
        """Return the state before learning."""
        inverse = torch.eye(self._sources, dtype=torch.double) / self.config.ridge
        return {
            "filtered": torch.zeros(batch, self._sources, dtype=torch.double),
            "weight": torch.zeros(batch, self.config.says.width, self._sources, dtype=torch.double),
            "inverse": inverse.repeat(batch, 1, 1),
        }

    def step(
        self, inputs: Mapping[str, Tensor], state: State, probe: Probe | None = None
    ) -> tuple[dict[str, Tensor], State]:
        """Learn from what was said at the end of the last window, then run one."""
        weight, inverse = self._learn(inputs["error"].double(), state)
        spikes = torch.cat([inputs[name] for name in self.config.receives], dim=2).double()
        left = self._kept ** torch.arange(len(spikes) - 1, -1, -1, dtype=torch.double)
        heard = (1 - self._kept) * torch.einsum("t,tbs->bs", left, spikes)
        filtered = self._kept ** len(spikes) * state["filtered"] + heard
        says = self.config.says.interval
        said = (says.lo + says.hi) / 2 + torch.einsum("bcs,bs->bc", weight, filtered)
        after = {"filtered": filtered, "weight": weight, "inverse": inverse}
        return {"said": said.clamp(says.lo, says.hi).float()}, after

    @torch.no_grad()
    def _learn(self, error: Tensor, state: State) -> tuple[Tensor, Tensor]:
        """Return the weights and P after an error (batch, components)."""
        if not error.any():
            return state["weight"], state["inverse"]
        heard = state["filtered"]
        spread = (state["inverse"] @ heard.unsqueeze(2)).squeeze(2)
        gain = spread / (1 + (heard * spread).sum(1, keepdim=True))
        gain = gain * error.any(1, keepdim=True)
        weight = state["weight"] + error.unsqueeze(2) * gain.unsqueeze(1)
        inverse = torch.baddbmm(state["inverse"], gain.unsqueeze(2), spread.unsqueeze(1), alpha=-1)
        return weight, inverse
