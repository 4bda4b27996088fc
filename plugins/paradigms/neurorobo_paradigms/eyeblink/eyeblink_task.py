"""The task of eyeblink conditioning: whether and when an eyelid responds to the tone, trial by trial."""

from collections.abc import Sequence
from statistics import fmean
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from neurorobo.bodies import Array, Body
from neurorobo.errors import NeuroroboError
from neurorobo.tasks.task import Flags, Task
from neurorobo.units import format_duration
from neurorobo_paradigms.eyeblink.conditioning_chamber import ConditioningChamber
from neurorobo_paradigms.eyeblink.eyeblink_task_config import EyeblinkTaskConfig


class Trial(NamedTuple):
    """What an eyelid did in one trial; times are from the onset of the tone, or from when it would have come.

    ``conditioned`` says whether it had responded between the task's `earliest` and the onset of the puff, ``onset_ms``
    when it first responded after the onset of the tone (None if it did not), ``peak_ms`` when it was shut furthest from
    then on, and ``peak`` how far, 0..1. ``felt`` is the share of the puff that was felt, 0 without one.
    """

    phase: str
    tone: bool
    puff: bool
    conditioned: bool
    onset_ms: float | None
    peak_ms: float
    peak: float
    felt: float


class EyeblinkTask(Task[ConditioningChamber]):
    """Shut the eye before the puff comes, and not much earlier; the reward of a motion is minus the puff that is felt.

    Figures of each phase, over its trials with a tone: ``conditioned.NAME``, the share of trials with a conditioned
    response; and of its last block ``late_conditioned.NAME``, ``late_peak_ms.NAME``, when the lid was shut furthest
    after the onset of the tone, and, of trials with a puff, ``late_felt.NAME``, the share of it that was felt. What
    there were no trials for is 0. More responses are better where tone and puff are paired, fewer elsewhere.
    """

    def __init__(self, config: EyeblinkTaskConfig, body: Body) -> None:
        if not isinstance(body, ConditioningChamber):
            raise NeuroroboError(
                f"`paradigms.eyeblink` needs a `paradigms.conditioning_chamber`, not a {type(body).__name__}"
            )
        interval = body.config.interval
        if config.earliest >= interval:
            raise NeuroroboError(
                f"`earliest` ({format_duration(config.earliest)}) must be less than the chamber's `interval` "
                f"({format_duration(interval)}), or no response can be conditioned"
            )
        super().__init__(config, body)
        self.config = config
        self.higher_is_better = frozenset(
            f"{figure}.{phase.name}"
            for phase in body.config.phases
            if phase.stimuli == "paired"
            for figure in ("conditioned", "late_conditioned")
        )
        self._schedule = [*body.config.schedule()]
        self.reset(0)

    def reset(self, batch: int, which: Flags | None = None) -> None:
        """Begin with the first trial."""
        if which is None:
            which, shape = np.ones(batch, dtype=np.bool_), (batch, len(self._schedule))
            self._felt_now: Array = np.zeros(batch)
            self._ended: NDArray[np.int64] = np.zeros(batch, dtype=np.int64)
            self._conditioned: Flags = np.zeros(shape, dtype=np.bool_)
            self._onset_ns: NDArray[np.int64] = np.zeros(shape, dtype=np.int64)  # 0 before there is one
            self._peak_ns: NDArray[np.int64] = np.zeros(shape, dtype=np.int64)
            self._peak: Array = np.zeros(shape)
            self._felt_ns: Array = np.zeros(shape)
        for values in (self._felt_now, self._ended, self._onset_ns, self._peak_ns, self._peak, self._felt_ns):
            values[which] = 0
        self._conditioned[which] = False

    def observe(self, duration_ns: int, running: Flags) -> None:
        """Look at the lids at the end of a motion."""
        chamber = self.body.config
        self._felt_now = self.body.read()["puff"][:, 0]
        for i in np.flatnonzero(running):
            elapsed_ns, closure = int(self.body.elapsed_ns[i]), float(self.body.closure[i])
            trial, within_ns = divmod(elapsed_ns, chamber.trial)
            self._ended[i] = trial
            since_tone_ns = within_ns - chamber.tone_onset
            if trial == len(self._schedule) or since_tone_ns <= 0:
                continue
            self._felt_ns[i, trial] += self._felt_now[i] * duration_ns
            if closure > self._peak[i, trial]:
                self._peak[i, trial], self._peak_ns[i, trial] = closure, since_tone_ns
            if closure >= self.config.threshold:
                self._onset_ns[i, trial] = self._onset_ns[i, trial] or since_tone_ns
                if self.config.earliest <= since_tone_ns <= chamber.interval:
                    self._conditioned[i, trial] = True

    def reward(self) -> Array:
        """Return minus the puff that is felt (batch)."""
        return -self._felt_now

    def terminated(self) -> Flags:
        """Return which episodes have had all trials."""
        return self._ended >= len(self._schedule)

    def truncated(self) -> Flags:
        """Return that none is cut short."""
        return np.zeros(len(self._ended), dtype=np.bool_)

    def trials(self, member: int) -> list[Trial]:
        """Return the trials that one of the batch has had so far."""
        return [
            Trial(
                phase=phase,
                tone=stimuli.tone,
                puff=stimuli.puff,
                conditioned=bool(self._conditioned[member, k]),
                onset_ms=self._onset_ns[member, k] * 1e-6 if self._onset_ns[member, k] else None,
                peak_ms=float(self._peak_ns[member, k]) * 1e-6,
                peak=float(self._peak[member, k]),
                felt=float(self._felt_ns[member, k]) / self.body.config.puff,
            )
            for k, (phase, stimuli) in enumerate(self._schedule[: self._ended[member]])
        ]

    def metrics(self) -> Sequence[dict[str, float]]:
        """Return the figures of each phase."""
        return [self._figures(self.trials(member)) for member in range(len(self._ended))]

    def _figures(self, trials: Sequence[Trial]) -> dict[str, float]:
        found = {}
        for name in (phase.name for phase in self.body.config.phases):
            with_tone = [trial for trial in trials if trial.phase == name and trial.tone]
            late = with_tone[-self.config.block :]
            with_puff = [trial for trial in trials if trial.phase == name and trial.puff][-self.config.block :]
            found[f"conditioned.{name}"] = _mean([trial.conditioned for trial in with_tone])
            found[f"late_conditioned.{name}"] = _mean([trial.conditioned for trial in late])
            found[f"late_peak_ms.{name}"] = _mean([trial.peak_ms for trial in late])
            found[f"late_felt.{name}"] = _mean([trial.felt for trial in with_puff])
        return found


def _mean(values: Sequence[float]) -> float:
    return fmean(values) if values else 0.0
