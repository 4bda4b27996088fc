"""Practice: regions act in the closed loop of their experiment, explore, and are told what they gain."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from torch import Tensor

from neurorobo.bodies import Array
from neurorobo.config.experiment import Experiment
from neurorobo.errors import NeuroroboError
from neurorobo.experiment.build import build_brain, build_task
from neurorobo.experiment.closed_loop import in_batches, run_episodes
from neurorobo.experiment.recorder import Sample
from neurorobo.experiment.rollout import loop_fingerprint
from neurorobo.graph.brain import Brain, BrainState
from neurorobo.graph.plan import Plan, Use
from neurorobo.learning.experience import Experience, Met, Performance, Windows
from neurorobo.learning.ppo_config import acting_use
from neurorobo.regions.region import Region
from neurorobo.tasks.task import Flags, Task

EXPLORING = 2**32
"""Added to the seed of an episode for what it explores, so that this does not hang together with its other noise."""


class Practice:
    """The closed loop of an experiment in which regions learn: a :class:`neurorobo.learning.experience.Practice`.

    ``trained`` are regions to take as they are at the time, ``learners`` among them; the others get the weights that
    the file names. Raises what building a brain and a task raises.
    """

    def __init__(
        self, experiment: Experiment, plan: Plan, learners: Collection[str], trained: Mapping[str, Region]
    ) -> None:
        self._experiment = experiment
        self._learners = learners
        self.brain = build_brain(experiment, plan, trained)
        task = build_task(experiment)
        assert task is not None
        self._task = task
        self.plan = plan
        self.observed = sum(sensor.width for sensor in task.body.sensors.values()) + 1

    def explore(self, seeds: Sequence[int], deviations: Mapping[str, float]) -> Experience:
        """Run one episode per seed; each command in ``deviations`` is drawn from a Gaussian around what the brain says.

        ``deviations`` are in the actuators' units. What an episode explores depends on its seed alone.
        """
        self.brain.eval()
        parts = []
        for batch in in_batches(seeds):
            notes = _Notes(self.brain, self._task, deviations, batch)
            results = run_episodes(self.brain, self._task, batch, recorders=[notes], explore=notes.explore)
            rates = [result.firing_rates.get(name, 0.0) for result in results for name in self._learners]
            parts.append(notes.experience(float(np.mean(rates))))
        return Experience.joined(parts)

    def perform(self, seeds: Sequence[int]) -> Performance:
        """Run one episode per seed as the brain says."""
        self.brain.eval()
        returns: list[float] = []
        metrics: list[Mapping[str, float]] = []
        for batch in in_batches(seeds):
            rewards = _Rewards(self._task)
            results = run_episodes(self.brain, self._task, batch, recorders=[rewards])
            returns += rewards.sum.tolist()
            metrics += [result.metrics for result in results]
        return Performance(returns, metrics)

    def fingerprint(self) -> str:
        """Return the SHA-256 of all that decides what the regions meet, but for their own weights."""
        return loop_fingerprint(self._experiment, self.brain, self._learners)


def _reward(task: Task[Any], running: Flags) -> Array:
    """Return the reward (batch) of the last motion, 0 for episodes that have ended; a NeuroroboError for no number."""
    reward = np.where(running, task.reward(), 0.0)
    if not np.isfinite(reward).all():
        given = reward[~np.isfinite(reward)][0]
        raise NeuroroboError(f"{type(task).__name__} gives a reward of {given}, of which nothing can be learned")
    return reward


@dataclass
class _Rewards:
    """Adds up the reward of each episode."""

    task: Task[Any]
    sum: Array = field(default_factory=lambda: np.zeros(1))
    most_neurons: int = 0

    def sample(self, sample: Sample) -> None:
        """Take the reward of a tick."""
        self.sum = self.sum + _reward(self.task, sample.running)


class _Notes:
    """Explores, and keeps what the episodes of a batch met, did and gained."""

    most_neurons = 0

    def __init__(self, brain: Brain, task: Task[Any], deviations: Mapping[str, float], seeds: Sequence[int]) -> None:
        self._brain = brain
        self._task = task
        self._deviations = deviations
        self._generators = [torch.Generator().manual_seed(seed + EXPLORING) for seed in seeds]
        self._edges = {name: brain.plan.command[name] for name in deviations}
        acting = (acting_use(edge, brain.plan) for edge in self._edges.values())
        self._uses = {use.name: use for use in acting if use is not None}
        self._now: tuple[Mapping[str, Tensor], BrainState]
        self._ticks: list[Met] = []
        self._windows: dict[str, list[Windows]] = {name: [] for name in self._uses}

    def explore(self, commands: Mapping[str, Tensor], state: BrainState) -> Mapping[str, Tensor]:
        """Return what is tried in place of what the brain says."""
        tried = dict(commands)
        for name, deviation in self._deviations.items():
            if name in commands:
                width = commands[name].shape[1]
                noise = torch.stack([torch.randn(width, generator=generator) for generator in self._generators])
                tried[name] = commands[name] + deviation * noise
        self._now = tried, state
        return tried

    def sample(self, sample: Sample) -> None:
        """Take what was met, done and gained in one tick."""
        tried, state = self._now
        said = {name: sample.outputs[edge.source][edge.output] for name, edge in self._edges.items() if name in tried}
        silence = {name: torch.zeros(len(sample.seeds), edge.reader_port.width) for name, edge in self._edges.items()}
        running = torch.from_numpy(sample.running.copy())
        tick_s = self._brain.plan.clock.tick_ns * 1e-9
        self._ticks.append(
            Met(
                observation=_observed(sample.observation, sample.time_s),
                following=_observed(self._task.body.read(), sample.time_s + tick_s),
                reward=torch.from_numpy(_reward(self._task, sample.running)).float(),
                running=running,
                truncated=torch.from_numpy(sample.running & self._task.truncated() & ~self._task.terminated()),
                command=torch.cat([tried.get(name, nothing) for name, nothing in silence.items()], dim=1),
                mean=torch.cat([said.get(name, nothing) for name, nothing in silence.items()], dim=1),
                due=torch.cat([torch.full_like(nothing, name in said) for name, nothing in silence.items()], dim=1),
            )
        )
        for name, use in self._uses.items():
            if name in sample.inputs:
                [inputs] = sample.inputs[name]
                self._windows[name].append(self._window(use, inputs, state, sample.tick, running))

    def _window(self, use: Use, inputs: Mapping[str, Tensor], state: BrainState, tick: int, running: Tensor) -> Windows:
        """Keep the windows of the episodes that are running; a step acts from rest, or from what its region carries."""
        region = self._brain.region(use.region)
        carried = region.config.carry == "always" and use.policy != "fresh"
        before = state.regions.get(use.region, {}) if carried else region.init_state(len(running))
        return Windows(
            {name: value[..., running, :] for name, value in inputs.items()},
            {name: value[running] for name, value in before.items()},
            torch.full((int(running.sum()),), tick),
            running.nonzero().squeeze(1),
        )

    def experience(self, rate: float) -> Experience:
        """Return what was kept; ``rate`` is the firing rate of the regions that learn."""
        return Experience.of(self._ticks, self._windows, rate)


def _observed(observation: Mapping[str, Array], time_s: float) -> Tensor:
    """Return what the critic sees (batch, width): all sensors, finite, and the time since the start."""
    columns = [np.nan_to_num(value, posinf=0.0, neginf=0.0) for value in observation.values()]
    return torch.from_numpy(np.column_stack([*columns, np.full(len(columns[0]), time_s)])).float()
