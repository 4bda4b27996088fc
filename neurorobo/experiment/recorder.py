"""Recorders: what a run leaves behind besides its summary."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from neurorobo.bodies import Array
from neurorobo.graph.plan import Plan
from neurorobo.tasks.task import Flags, Task

Counts = NDArray[np.int64]


@dataclass(frozen=True)
class Setting:
    """What a recorder is told before a run: where to write, what is run, and with which seeds (of all episodes)."""

    folder: Path
    name: str
    plan: Plan
    seeds: Sequence[int]
    task: Task[Any] | None


@dataclass(frozen=True)
class Sample:
    """One tick of a run, batch first; arrays are those of the moment and must be copied to be kept.

    ``observation`` was read at the tick's start, ``given`` is what the body carried out until its end, and
    ``interventions`` counts, for each actuator (batch), how often the command layer had to change it for that: new
    commands and held ones, the latter when they are changed further than before. ``inputs`` holds, for each step that
    ran, what each of its iterations was given, in the form that the ports of its region carry; ``outputs`` its ports as
    numbers (batch, width), of its last iteration. ``spikes`` holds (steps, batch, neurons) by step and layer, and
    ``rates`` how many there were per neuron and step (batch), for recorders that want them. What the brain has made, of
    ``inputs`` to ``rates``, nobody changes, and it need not be copied. ``seeds`` are those of this batch; of a large
    run, one batch follows the other, each from tick 0.
    """

    tick: int
    time_s: float
    running: Flags
    observation: Mapping[str, Array]
    given: Mapping[str, Array]
    interventions: Mapping[str, Counts]
    inputs: Mapping[str, Sequence[Mapping[str, Tensor]]]
    outputs: Mapping[str, Mapping[str, Tensor]]
    spikes: Mapping[str, Mapping[str, Tensor]]
    rates: Mapping[str, Mapping[str, Tensor]]
    seeds: Sequence[int]


class Sampler(Protocol):
    """Takes every sample of a run; it ``wants_spikes`` or not."""

    @property
    def wants_spikes(self) -> bool:
        """Whether samples are to hold the spikes."""

    def sample(self, sample: Sample) -> None:
        """Take note of one tick."""


class Recorder(ABC):
    """Keeps something of a run; samples are buffered, files are written at the end.

    A recorder that ``wants_spikes`` is given the first batch only: those of a whole large run would fill the memory.
    """

    wants_spikes: ClassVar[bool] = False

    def __init__(self, setting: Setting) -> None:
        """Prepare to record one run."""
        self.setting = setting

    @abstractmethod
    def sample(self, sample: Sample) -> None:
        """Take note of one tick."""

    @abstractmethod
    def finish(self) -> Path | None:
        """Write what was kept, and return the file; called once, also if the run was interrupted.

        An OSError is told to the user as what cannot be written.
        """
