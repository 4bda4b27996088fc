"""Learning from what a region meets by itself: its states in the closed loop, among those of other data (DAgger)."""

from collections.abc import Mapping, Sequence
from typing import Protocol

import torch
from torch import Tensor

from neurorobo.errors import NeuroroboError, did_you_mean
from neurorobo.learning.evaluate import Data, numbers
from neurorobo.learning.phase import OnPolicy
from neurorobo.regions.port import Port
from neurorobo.seeds import TRAINING_SEEDS


class Rollout(Protocol):
    """The closed loop of an experiment, in which a region acts with its present weights."""

    def __call__(self, seeds: Sequence[int]) -> Mapping[str, Tensor]:
        """Run one episode per seed and return all inputs that the region met, as numbers (inputs met, width)."""

    def fingerprint(self) -> str:
        """Return a hash of all that the episodes depend on besides the region and the seeds."""


class OnPolicyData:
    """Data of which a share is what a region met by itself; the rest comes from ``data``.

    ``inputs`` are the ports of the region. By :meth:`tensors` and :meth:`restore` it outlives an interruption.
    """

    def __init__(self, data: Data, rollout: Rollout, settings: OnPolicy, inputs: Mapping[str, Port]) -> None:
        self._data = data
        self._rollout = rollout
        self._settings = settings
        self._inputs = inputs
        self._visits: list[Mapping[str, Tensor]] = []
        self._met: Mapping[str, Tensor] = {}
        self._drawn = 0
        self.fingerprint = rollout.fingerprint()

    def draw(self, batch: int, generator: torch.Generator) -> Mapping[str, Tensor]:
        """Return numbers (batch, width) by input.

        Raises a NeuroroboError if the data have an input that the region lacks, or lack one without an initial value.
        """
        settings = self._settings
        if self._drawn % settings.every == 0:
            seeds = torch.randint(*TRAINING_SEEDS, (settings.episodes,), generator=generator).tolist()
            self._keep([*self._visits, self._rollout(seeds)][-settings.keep :])
        self._drawn += 1
        count = settings.count(batch)
        chosen = torch.randint(len(next(iter(self._met.values()))), (count,), generator=generator)
        met = {name: values[chosen] for name, values in self._met.items()}
        if count == batch:
            return met
        drawn = self._data.draw(batch - count, generator)
        if foreign := sorted(drawn.keys() - met.keys()):
            raise NeuroroboError(
                f"the training data have `{foreign[0]}`, which the region has no input for and cannot meet by itself"
                f"{did_you_mean(foreign[0], met)}; leave it out, or train without `on_policy`"
            )
        return {
            name: torch.cat([numbers(name, port, drawn, batch - count), met[name]])
            for name, port in self._inputs.items()
        }

    def tensors(self) -> dict[str, Tensor]:
        """Return what was met, as named tensors."""
        return {f"{i}.{name}": values for i, visit in enumerate(self._visits) for name, values in visit.items()}

    def restore(self, tensors: Mapping[str, Tensor], drawn: int) -> None:
        """Go on after ``drawn`` draws, from tensors of :meth:`tensors`."""
        visits: dict[int, dict[str, Tensor]] = {}
        for key, values in tensors.items():
            number, _, name = key.partition(".")
            visits.setdefault(int(number), {})[name] = values
        self._keep([visits[number] for number in sorted(visits)])
        self._drawn = drawn

    def _keep(self, visits: Sequence[Mapping[str, Tensor]]) -> None:
        """Keep these visits; joined, they are no longer such tensors of inference mode as cannot be trained through."""
        self._visits = list(visits)
        self._met = {name: torch.cat([visit[name] for visit in visits]).clone() for name in self._inputs}
