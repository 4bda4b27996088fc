"""The chamber in which an eyelid is conditioned."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from neurorobo.bodies.body import Array, Body
from neurorobo_paradigms.eyeblink.conditioning_chamber_config import ConditioningChamberConfig


class ConditioningChamber(Body):
    """A batch of eyes, each with a tone and a puff that come by the clock; nothing in it is random.

    ``closure`` (batch) is 0 for an open eye and 1 for a shut one. It follows the commanded firing rate r as
    ``lid_time_constant * d closure / dt = min(r / full_closure, 1) - closure``. There is no reflex: a puff alone does
    not shut the eye. ``elapsed_ns`` (batch) is the time since the start of the first trial; behind the last one there
    are no more stimuli.
    """

    def __init__(self, config: ConditioningChamberConfig) -> None:
        super().__init__(config)
        self.config = config
        trials = [stimuli for _, stimuli in config.schedule()]
        self._has_tone = np.array([*(stimuli.tone for stimuli in trials), False])
        self._has_puff = np.array([*(stimuli.puff for stimuli in trials), False])
        self.reset([])

    def reset(self, seeds: Sequence[int], which: NDArray[np.bool_] | None = None) -> None:
        """Open the eyes and begin with the first trial."""
        if which is None:
            which = np.ones(len(seeds), dtype=np.bool_)
            self.closure: Array = np.zeros(len(seeds))
            self.elapsed_ns: NDArray[np.int64] = np.zeros(len(seeds), dtype=np.int64)
            self._rate_Hz: Array = np.zeros(len(seeds))
        self.closure[which] = self._rate_Hz[which] = 0.0
        self.elapsed_ns[which] = 0

    def read(self) -> dict[str, Array]:
        """Return what is heard and felt now."""
        tone, puff = self._stimuli()
        felt = puff * (1.0 - self.closure)
        return {"tone": tone[:, None], "puff": felt[:, None], "closure": self.closure[:, None].copy()}

    def advance(self, commands: Mapping[str, Array], duration_ns: int) -> None:
        """Move the lid for ``duration_ns``, by the exact solution of its equation."""
        if "eyelid" in commands:
            self._rate_Hz = np.array(commands["eyelid"][:, 0], dtype=np.float64)
        held = np.minimum(self._rate_Hz / self.config.full_closure, 1.0)
        self.closure = held + (self.closure - held) * math.exp(-duration_ns / self.config.lid_time_constant)
        self.elapsed_ns = self.elapsed_ns + duration_ns

    def stop(self) -> None:
        """Let go of the lid."""
        self._rate_Hz = np.zeros_like(self._rate_Hz)

    def _stimuli(self) -> tuple[Array, Array]:
        """Return tone and puff, 0 or 1 (batch)."""
        config = self.config
        trial = np.minimum(self.elapsed_ns // config.trial, len(self._has_tone) - 1)
        since_tone_ns = self.elapsed_ns % config.trial - config.tone_onset
        before_end = since_tone_ns < config.interval + config.puff
        tone = self._has_tone[trial] & (since_tone_ns >= 0) & before_end
        puff = self._has_puff[trial] & (since_tone_ns >= config.interval) & before_end
        return tone.astype(np.float64), puff.astype(np.float64)
