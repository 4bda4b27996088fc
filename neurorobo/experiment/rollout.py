"""Rollouts for learning: a region acts in the closed loop of its experiment, and what it meets is kept."""

import hashlib
import json
from collections.abc import Collection, Mapping, Sequence

import torch
from torch import Tensor

from neurorobo.config.experiment import Experiment
from neurorobo.experiment.build import build_brain, build_task
from neurorobo.experiment.closed_loop import in_batches, run_episodes
from neurorobo.experiment.recorder import Sample
from neurorobo.graph.brain import Brain
from neurorobo.graph.plan import Plan
from neurorobo.regions.region import Region
from neurorobo.regions.values import convert


class Rollout:
    """The closed loop of an experiment in which one region learns: a :class:`neurorobo.learning.on_policy.Rollout`.

    ``trained`` are regions to take as they are at the time; the others get the weights that the file names. Raises what
    building a brain and a task raises.
    """

    def __init__(
        self, experiment: Experiment, plan: Plan, learners: Collection[str], trained: Mapping[str, Region]
    ) -> None:
        self._experiment = experiment
        [self._learner] = learners
        self._brain = build_brain(experiment, plan, trained)
        self._task = build_task(experiment)

    def __call__(self, seeds: Sequence[int]) -> dict[str, Tensor]:
        """Run one episode per seed; inputs are read back from their spikes, as exactly as the region can know them."""
        region = self._brain.region(self._learner)
        met = _Met(region, [use.name for use in self._brain.plan.uses() if use.region == self._learner])
        episode = self._experiment.episode
        duration_ns = None if episode is None else episode.duration
        learning = region.training
        self._brain.eval()
        try:
            for batch in in_batches(seeds):
                run_episodes(self._brain, self._task, batch, duration_ns=duration_ns, recorders=[met])
        finally:
            region.train(learning)
        return {name: torch.cat(values) for name, values in met.numbers.items()}

    def fingerprint(self) -> str:
        """Return the SHA-256 of all that decides what the region meets, but for the region's own weights."""
        return loop_fingerprint(self._experiment, self._brain, (self._learner,))


def loop_fingerprint(experiment: Experiment, brain: Brain, learners: Collection[str]) -> str:
    """Return the SHA-256 of all that decides what happens in a closed loop, but for the weights of some regions."""
    resolved = experiment.resolved()
    loop = {key: resolved.get(key) for key in ("seed", "time", "body", "task", "episode", "steps", "command")}
    regions = {name: resolved["regions"][name] for name in brain.names}
    for region in regions.values():
        region.pop("weights", None)  # what they are matters, not where they came from
    digest = hashlib.sha256(json.dumps([loop, regions], sort_keys=True).encode())
    for name in brain.names:
        if name not in learners:
            for key, tensor in brain.region(name).state_dict().items():
                digest.update(f"{name}.{key}".encode())
                digest.update(tensor.contiguous().numpy().tobytes())
    return digest.hexdigest()


class _Met:
    """Keeps the inputs of a region, of the episodes that are running, as numbers."""

    most_neurons = 0

    def __init__(self, region: Region, steps: Sequence[str]) -> None:
        self.numbers: dict[str, list[Tensor]] = {name: [] for name in region.input_ports}
        self._ports = region.input_ports
        self._steps = steps

    def sample(self, sample: Sample) -> None:
        """Take what each iteration of each step of the region was given."""
        running = torch.from_numpy(sample.running)
        for given in (given for step in self._steps for given in sample.inputs.get(step, ())):
            for name, port in self._ports.items():
                self.numbers[name].append(convert(given[name], port.code, None, 0, ())[running])
