"""Recorders: what a run leaves behind besides its summary."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from neurorobo.bodies import Array
from neurorobo.engine import Fired
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


class LayerSpikes(NamedTuple):
    """What a layer fired in a window: ``some`` (steps, batch, neurons) of its ``neurons``, evenly spaced, as booleans.

    ``fired`` (batch) is how many spikes of all neurons there are.
    """

    some: NDArray[np.bool_]
    neurons: int
    fired: Tensor

    @classmethod
    def of(cls, spikes: Tensor, fired: Tensor, most: int) -> "LayerSpikes":
        """Keep at most so many neurons of spikes (steps, batch, neurons)."""
        neurons = spikes.shape[2]
        return cls((spikes[:, :, _evenly_spaced(neurons, min(neurons, most))] != 0).numpy(), neurons, fired)

    @classmethod
    def of_bits(cls, fired: Fired, count: Tensor, most: int) -> "LayerSpikes":
        """Keep at most so many neurons of what a layer fired, given its number of spikes (batch)."""
        return cls(fired.of(_evenly_spaced(fired.neurons, min(fired.neurons, most))).numpy(), fired.neurons, count)

    def of_first(self) -> "LayerSpikes":
        """Return those of the first of the batch alone."""
        if self.fired.shape[0] == 1:  # in a quarter of the time of `len`
            return self
        return self._replace(some=self.some[:, :1].copy(), fired=self.fired[:1].clone())

    @property
    def rate(self) -> Tensor:
        """Return spikes per neuron and step (batch)."""
        return self.fired / (len(self.some) * self.neurons)


@cache
def _evenly_spaced(neurons: int, most: int) -> Tensor:
    return torch.from_numpy(np.linspace(0, neurons - 1, most).round().astype(np.int64))


@dataclass(frozen=True)
class Sample:
    """One tick of a run, batch first; arrays are those of the moment and must be copied to be kept.

    ``observation`` was read at the tick's start, ``given`` is what the body carried out until its end, and
    ``interventions`` counts, for each actuator (batch), how often the command layer had to change it for that: new
    commands and held ones, the latter when they are changed further than before. ``inputs`` holds, for each step that
    ran, what each of its iterations was given, in the form that the ports of its region carry; ``outputs`` its ports as
    numbers (batch, width), of its last iteration. ``spikes`` holds those of each step and layer, for recorders that
    want them. What the brain has made, ``inputs``, ``outputs`` and ``spikes``, nobody changes, and it need not be
    copied. ``seeds`` are those of this batch; of a large run, one batch follows the other, each from tick 0.
    ``latency_ms`` is how long it took from the sensors to the commands, by the wall clock, if there is a body.
    """

    tick: int
    time_s: float
    running: Flags
    observation: Mapping[str, Array]
    given: Mapping[str, Array]
    interventions: Mapping[str, Counts]
    inputs: Mapping[str, Sequence[Mapping[str, Tensor]]]
    outputs: Mapping[str, Mapping[str, Tensor]]
    spikes: Mapping[str, Mapping[str, LayerSpikes]]
    seeds: Sequence[int]
    latency_ms: float | None = None


class Sampler(Protocol):
    """Takes every sample of a run."""

    @property
    def most_neurons(self) -> int:
        """Of how many neurons of each layer samples are to hold the spikes at least, if it has them; 0 if of none."""

    def sample(self, sample: Sample) -> None:
        """Take note of one tick."""


class Recorder(ABC):
    """Keeps something of a run; samples are buffered, files are written at the end.

    A recorder that asks for spikes, of ``most_neurons`` of each layer, is given the first batch only: those of a whole
    large run would fill the memory.
    """

    most_neurons: ClassVar[int] = 0

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
