"""Experience: what a policy met, did and gained while it explored, and how much better that was than expected."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import accumulate
from typing import Protocol

import torch
from torch import Tensor

from neurorobo.graph.plan import Plan
from neurorobo.regions.region import State


@dataclass(frozen=True)
class Windows:
    """All that windows of one step were given, in the form that the step runs on, side by side.

    ``tick`` and ``episode`` (windows) tell when and where each ran.
    """

    inputs: Mapping[str, Tensor]
    state: State
    tick: Tensor
    episode: Tensor

    def choose(self, chosen: Tensor) -> tuple[dict[str, Tensor], State]:
        """Return the inputs and the state of some windows, by number."""
        inputs = {name: value.index_select(-2, chosen) for name, value in self.inputs.items()}
        return inputs, {name: value[chosen] for name, value in self.state.items()}

    @classmethod
    def joined(cls, parts: Sequence["Windows"]) -> "Windows":
        """Return all windows of several."""
        return cls(
            {name: torch.cat([part.inputs[name] for part in parts], dim=-2) for name in parts[0].inputs},
            {name: torch.cat([part.state[name] for part in parts]) for name in parts[0].state},
            torch.cat([part.tick for part in parts]),
            torch.cat([part.episode for part in parts]),
        )


@dataclass(frozen=True)
class Met:
    """What episodes side by side met, did and gained: in one tick (episodes, ...), or in all (ticks, episodes, ...).

    ``observation`` is what was observed before a tick, ``following`` after it (..., width). Episodes that ended early
    are ``running`` (bool) no more; ``truncated`` (bool) marks the tick at which the time limit ended one, whose future
    the critic is to estimate. ``command`` is what was tried and ``mean`` what the brain said (..., components), of
    those components that are ``due`` (0 or 1).
    """

    observation: Tensor
    following: Tensor
    reward: Tensor
    running: Tensor
    truncated: Tensor
    command: Tensor
    mean: Tensor
    due: Tensor


@dataclass(frozen=True)
class Experience(Met):
    """What was met in all ticks of episodes, (ticks, episodes, ...).

    ``windows`` holds those of each step that commands, in order of time. ``rate`` is the firing rate of the regions
    that learn.
    """

    windows: Mapping[str, Windows]
    rate: float

    @classmethod
    def of(cls, ticks: Sequence[Met], windows: Mapping[str, Sequence[Windows]], rate: float) -> "Experience":
        """Return what the ticks of one batch of episodes make up."""
        columns = {field.name: torch.stack([getattr(tick, field.name) for tick in ticks]) for field in fields(Met)}
        return cls(**columns, windows={name: Windows.joined(each) for name, each in windows.items()}, rate=rate)

    @classmethod
    def joined(cls, parts: Sequence["Experience"]) -> "Experience":
        """Return the episodes of several batches side by side."""
        columns = {field.name: _side_by_side([getattr(part, field.name) for part in parts]) for field in fields(Met)}
        firsts = [0, *accumulate(part.running.shape[1] for part in parts)]
        windows = {
            name: Windows.joined(
                [
                    replace(part.windows[name], episode=part.windows[name].episode + first)
                    for first, part in zip(firsts, parts, strict=False)
                ]
            )
            for name in parts[0].windows
        }
        rate = sum(part.rate * part.running.shape[1] for part in parts) / firsts[-1]
        return cls(**columns, windows=windows, rate=rate)

    @property
    def mean_return(self) -> float:
        """The mean over the episodes of the sum of their rewards."""
        return float((self.reward * self.running).sum(0).mean())

    def returns(self, discount: float) -> tuple[Tensor, Tensor]:
        """Return all that was observed (n, width), and the discounted rewards that followed (n)."""
        later, found = torch.zeros_like(self.reward[0]), torch.zeros_like(self.reward)
        for tick in range(len(self.reward) - 1, -1, -1):
            later = found[tick] = self.running[tick] * (self.reward[tick] + discount * later)
        return self.observation[self.running], found[self.running]


def _side_by_side(parts: Sequence[Tensor]) -> Tensor:
    """Join (ticks, episodes, ...) of unequal numbers of ticks; zeros follow the shorter ones."""
    most = max(len(part) for part in parts)
    return torch.cat([torch.cat([part, part.new_zeros(most - len(part), *part.shape[1:])]) for part in parts], dim=1)


@dataclass(frozen=True)
class Performance:
    """What a policy gains without exploring: the sum of the rewards, and the task's figures, of each episode."""

    returns: Sequence[float]
    metrics: Sequence[Mapping[str, float]]

    def to_json(self) -> dict[str, list[float]]:
        """Return the ``return`` and the figures, each a list over the episodes."""
        figures = {name: [episode[name] for episode in self.metrics] for name in self.metrics[0]}
        return {"return": list(self.returns), **figures}


class Practice(Protocol):
    """The closed loop of an experiment, in which regions act with their present weights.

    ``observed`` is how many numbers an observation has.
    """

    plan: Plan
    observed: int

    def explore(self, seeds: Sequence[int], deviations: Mapping[str, float]) -> Experience:
        """Run one episode per seed; each command in ``deviations`` is drawn from a Gaussian around the brain's."""

    def perform(self, seeds: Sequence[int]) -> Performance:
        """Run one episode per seed as the brain says."""

    def fingerprint(self) -> str:
        """Return a hash of all that the episodes depend on besides the regions that learn and the seeds."""


def advantages(
    experience: Experience, value: Tensor, following: Tensor, *, discount: float, gae_lambda: float
) -> Tensor:
    """Return the generalised advantage estimate (ticks, episodes) of what was done; zero where nothing runs.

    ``value`` and ``following`` (ticks, episodes) are the critic's, of what was observed before and after. Source: Eq.
    11 to 16 of Schulman et al. 2016; an episode that was truncated goes on at the value of its last observation, one
    that terminated gains nothing more.
    """
    running = experience.running
    goes_on = torch.cat([running[1:], torch.zeros_like(running[:1])])
    following = torch.where(goes_on | experience.truncated, following, 0.0)
    delta = experience.reward + discount * following - value
    found = torch.zeros_like(delta)
    later = torch.zeros_like(delta[0])
    for tick in range(len(delta) - 1, -1, -1):
        later = torch.where(running[tick], delta[tick] + discount * gae_lambda * goes_on[tick] * later, 0.0)
        found[tick] = later
    return found
