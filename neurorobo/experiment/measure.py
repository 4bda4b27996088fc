"""Measuring a brain at work: what its regions cost, per region, per use and per control period."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

from torch import Tensor

from neurorobo.config.experiment import Experiment
from neurorobo.engine import Probe
from neurorobo.experiment.build import build_brain, build_task
from neurorobo.experiment.closed_loop import run_episodes
from neurorobo.experiment.plan import build_plan
from neurorobo.experiment.weights import weights_file
from neurorobo.graph.brain import Brain, BrainState, Observer
from neurorobo.graph.plan import Edge, Use
from neurorobo.measures.size import Size, size_of
from neurorobo.measures.work import Work, WorkMeter


def measure_experiment(
    experiment: Experiment,
    seeds: Sequence[int],
    progress: Callable[[int, int], None] = lambda tick, running: None,
) -> dict[str, Any]:
    """Run one episode per seed and return what the brain cost, ready for JSON.

    ``regions`` has the size of each region, its work and that of each of its uses; ``total`` that of all regions. Work
    is the mean per control period. ``stored`` is the size of the weights file in bytes, None where there is none.
    Episodes run one after the other, each by itself, as a robot would run them. Raises what building a brain does.
    """
    plan = build_plan(experiment)
    brain = build_brain(experiment, plan)
    task = build_task(experiment)
    watched = _WatchedBrain(brain)
    with ExitStack() as watching:
        for meter in watched.meters.values():
            watching.enter_context(meter.watching())
        for seed in seeds:
            run_episodes(
                watched,
                task,
                [seed],
                duration_ns=None if experiment.episode is None else experiment.episode.duration,
                progress=progress,
            )
    periods = watched.ticks / plan.clock.ticks("control")
    sizes = {name: size_of(brain.region(name)) for name in brain.names}
    works = {
        name: {use.name: watched.work[use.name] for use in plan.uses() if use.region == name} for name in brain.names
    }
    regions: dict[str, Any] = {}
    for name, of_uses in works.items():
        stored = weights_file(name, experiment).stat().st_size if experiment.regions[name].weights else None
        regions[name] = {
            **_static(sizes[name], stored),
            **_per_period(sum(of_uses.values(), Work()), periods),
            "not_counted": watched.meters[name].not_counted(),
            "uses": {use: _per_period(work, periods) for use, work in of_uses.items()},
        }
    total = {
        **_static(sum(sizes.values(), Size()), sum(region["stored"] or 0 for region in regions.values())),
        **_per_period(sum(watched.work.values(), Work()), periods),
    }
    return {"seeds": list(seeds), "control_periods": periods, "regions": regions, "total": total}


def _static(size: Size, stored: int | None) -> dict[str, Any]:
    return {
        "parameter_count": size.parameter_count,
        "footprint": size.footprint,
        "stored": stored,
        "connection_sparsity": size.connection_sparsity,
    }


def _per_period(work: Work, periods: float) -> dict[str, Any]:
    return {
        "windows": work.windows / periods,
        "activation_sparsity": work.activation_sparsity,
        "effective_macs": work.effective_macs / periods,
        "effective_acs": work.effective_acs / periods,
        "dense": work.dense / periods,
    }


class _WatchedBrain(Brain):
    """A brain that adds up what its meters count for each use."""

    def __init__(self, brain: Brain) -> None:
        regions = {name: brain.region(name) for name in brain.names}
        super().__init__(brain.plan, regions)
        self.meters = {name: WorkMeter(region) for name, region in regions.items()}
        self.work = {use.name: Work() for use in brain.plan.uses()}
        self.ticks = 0

    def tick(
        self, observation: Mapping[str, Tensor], state: BrainState, observer: Observer | None = None
    ) -> tuple[dict[str, Tensor], BrainState]:
        """Run everything that is due, and count it."""
        assert observer is not None
        self.ticks += 1
        return super().tick(observation, state, _Counting(self, observer))


@dataclass(frozen=True)
class _Counting:
    """Observes a watched brain, and lets another observe it too."""

    brain: _WatchedBrain
    other: Observer

    def probe(self, use: Use, *, last: bool) -> Probe:
        """Let the meter and the other hear the spikes of a use."""
        meter = self.brain.meters[use.region]
        other = self.other.probe(use, last=last)

        def hear(layer: str, spikes: Tensor) -> None:
            meter.hear(layer, spikes)
            if other is not None:
                other(layer, spikes)

        return hear

    def used(
        self,
        use: Use,
        iteration: int,
        inputs: Mapping[str, Tensor],
        outputs: Mapping[str, Tensor],
        numbers: Mapping[str, Tensor],
    ) -> None:
        """Take the counts of a use."""
        self.brain.work[use.name] += self.brain.meters[use.region].take(1, inputs)
        self.other.used(use, iteration, inputs, outputs, numbers)

    def saturated(self, edge: Edge, count: Tensor) -> None:
        """Pass it on."""
        self.other.saturated(edge, count)
