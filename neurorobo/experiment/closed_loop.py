"""The closed loop: brain, command layer, body and task, tick by tick, many episodes side by side."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from torch import Tensor

from neurorobo.bodies import Array
from neurorobo.engine import Fired, Probe
from neurorobo.errors import NeuroroboError
from neurorobo.experiment.memory import Memory, only_running
from neurorobo.experiment.recorder import Counts, LayerSpikes, Sample, Sampler
from neurorobo.graph.brain import Brain, BrainState
from neurorobo.graph.plan import Edge, Use
from neurorobo.regions.values import to_numbers
from neurorobo.tasks.supervised import SupervisedTask
from neurorobo.tasks.task import Flags, Task

Metrics = dict[str, float]

LARGEST_BATCH = 16
"""Episodes to run side by side; more of them follow in further batches.

The spikes of many more would not stay in the cache, and each of them would take longer.
"""


def in_batches(seeds: Sequence[int], most: int = LARGEST_BATCH) -> Iterator[Sequence[int]]:
    """Yield the seeds of the episodes to run side by side, in order."""
    for start in range(0, len(seeds), most):
        yield seeds[start : start + most]


@dataclass(frozen=True)
class EpisodeResult:
    """One episode: its seed, the task's metrics, and the mean firing rate of each region.

    Rates are spikes per neuron and step, 0..1, and count the neurons inside and at the output of a region, not those of
    the input code. ``saturations`` counts, for each ``<step>.<input>`` where there were any, the components of values
    out of the range of the input's code. ``stopped`` says why a guard of the body ended the episode, if one did.
    """

    seed: int
    metrics: Metrics
    firing_rates: Mapping[str, float]
    saturations: Mapping[str, int] = field(default_factory=dict)
    stopped: str | None = None


def run_episodes(
    brain: Brain,
    task: Task[Any] | None,
    seeds: Sequence[int],
    *,
    duration_ns: int | None = None,
    recorders: Sequence[Sampler] = (),
    explore: Callable[[Mapping[str, Tensor], BrainState], Mapping[str, Tensor]] = lambda commands, state: commands,
    memory: Memory | None = None,
    progress: Callable[[int, int], None] = lambda tick, running: None,
) -> list[EpisodeResult]:
    """Run one episode per seed, all in one batch, until each has ended or ``duration_ns`` is over.

    Without a task there is no body: the brain runs by itself for ``duration_ns``. ``progress`` is told the tick and
    how many episodes are still running. ``explore`` is given the commands of a tick and the brain's state before it,
    and returns what to command instead. What an episode does depends on its seed alone, not on the batch. The body is
    stopped at the end, also when that is Ctrl-C or an error.

    Regions that learn as they run start from what is in the ``memory``, and leave there what they know when their
    episode ends; without one, they start from their weights alone, and nothing is left.
    """
    if task is None and duration_ns is None:
        raise ValueError("without a task, the duration must be given")
    tick_ns = brain.plan.clock.tick_ns
    batch = len(seeds)
    running: Flags = np.ones(batch, dtype=np.bool_)
    supervised = None if task is None else SupervisedTask(task)
    watch = _Watch(batch, bool(recorders), max((recorder.most_neurons for recorder in recorders), default=0))
    state = brain.init_state(seeds)
    if memory is not None:
        state = memory.recall(state)
    with torch.inference_mode(), _stopped_at_the_end(task):
        if supervised is not None:
            supervised.reset(seeds, batch)
        while running.any() and (duration_ns is None or state.tick * tick_ns < duration_ns):
            progress(state.tick, int(running.sum()))
            tick = state.tick
            if supervised is not None:
                supervised.body.latencies.sensed()
            observation = {} if supervised is None else supervised.body.read()
            _check(observation, running)
            watch.begin(running)
            # Of episodes that have ended, a sensor may report anything; what the brain makes of it does not matter.
            finite = {name: np.nan_to_num(value, posinf=0.0, neginf=0.0) for name, value in observation.items()}
            numbers = {name: torch.as_tensor(value, dtype=torch.float32) for name, value in finite.items()}
            before = state
            commands, after = brain.tick(numbers, before, watch)
            tried = explore(commands, before)
            state = after if memory is None else only_running(brain, before, after, running)
            watch.end()
            given: Mapping[str, Array] = {}
            interventions: Mapping[str, Counts] = {}
            ended = np.zeros(batch, dtype=np.bool_)
            latency_ms: float | None = None
            if supervised is not None:
                wanted = {name: value.numpy().astype(np.float64) for name, value in tried.items()}
                supervised.body.latencies.commanded()  # a real body says so again, once they are sent
                given, ended = supervised.step(wanted, tick_ns, running)
                interventions = supervised.supervisor.latest
                latency_ms = supervised.body.latencies.latest_ms
            sample = Sample(
                tick=tick,
                time_s=tick * tick_ns * 1e-9,
                running=running,
                observation=observation,
                given=given,
                interventions=interventions,
                inputs=watch.inputs,
                outputs=watch.outputs,
                spikes=watch.spikes,
                seeds=seeds,
                latency_ms=latency_ms,
            )
            for recorder in recorders:
                recorder.sample(sample)
            running = running & ~ended
    if memory is not None:
        memory.keep(brain, state)
    metrics: Sequence[Metrics] = [{} for _ in seeds] if supervised is None else supervised.metrics()
    results = []
    for i, seed in enumerate(seeds):
        rates = {region: float(rate[i]) for region, rate in watch.firing_rates().items()}
        saturations = {place: n for place, count in watch.saturations.items() if (n := int(count[i]))}
        trip = None if supervised is None else supervised.supervisor.trips.get(i)
        stopped = None if trip is None else str(trip)
        results.append(EpisodeResult(seed, metrics[i], rates, saturations, stopped))
    return results


@contextmanager
def _stopped_at_the_end(task: Task[Any] | None) -> Iterator[None]:
    """Stop the task's body, however the block ends."""
    try:
        yield
    finally:
        if task is not None:
            task.body.stop()


def _check(observation: Mapping[str, Array], running: Flags) -> None:
    """Raise if a sensor of a running episode reports what is not a number."""
    for name, value in observation.items():
        broken = value[running][~np.isfinite(value[running])]
        if broken.size:
            raise NeuroroboError(f"the sensor `{name}` reports {broken[0]}: the body was stopped; check the sensor")


@dataclass(frozen=True)
class _Probe:
    """Counts the spikes of a use, and perhaps keeps some."""

    watch: "_Watch"
    use: Use
    keeps: bool

    def __call__(self, layer: str, spikes: Tensor) -> None:
        """Take the spikes (steps, batch, neurons) of one layer."""
        steps, _, neurons = spikes.shape
        count = spikes.sum((0, 2))
        self._count(count, steps * neurons)
        if self.keeps:
            self._keep(layer, LayerSpikes.of(spikes, count, self.watch.most_neurons))

    def hear(self, layer: str, fired: Fired) -> None:
        """Take what one layer fired."""
        count = fired.counts()
        self._count(count, fired.steps * fired.neurons)
        if self.keeps:
            self._keep(layer, LayerSpikes.of_bits(fired, count, self.watch.most_neurons))

    def _count(self, count: Tensor, chances: int) -> None:
        known, known_chances = self.watch.heard.get(self.use.region, (0, 0))
        self.watch.heard[self.use.region] = (known + count, known_chances + chances)

    def _keep(self, layer: str, spikes: LayerSpikes) -> None:
        self.watch.spikes.setdefault(self.use.name, {})[layer] = spikes


@dataclass
class _Watch:
    """Observes a brain for the samples, the firing rates and the saturations."""

    batch: int
    keeps_values: bool
    most_neurons: int
    inputs: dict[str, list[Mapping[str, Tensor]]] = field(default_factory=dict)
    latest: dict[str, tuple[Use, Mapping[str, Tensor], Mapping[str, Tensor]]] = field(default_factory=dict)
    outputs: dict[str, dict[str, Tensor]] = field(default_factory=dict)  # as numbers
    spikes: dict[str, dict[str, LayerSpikes]] = field(default_factory=dict)
    running: Tensor = field(init=False)
    heard: dict[str, tuple[Tensor, int]] = field(default_factory=dict)  # of this tick: spikes (batch), and chances
    fired: dict[str, Tensor] = field(default_factory=dict)
    chances: dict[str, Tensor] = field(default_factory=dict)
    saturations: dict[str, Tensor] = field(default_factory=dict)

    def begin(self, running: Flags) -> None:
        """Start a tick, in which the ``running`` episodes count."""
        self.inputs, self.latest, self.spikes, self.heard = {}, {}, {}, {}
        self.running = torch.from_numpy(running.astype(np.float64))

    def end(self) -> None:
        """End a tick."""
        self.outputs = {
            use.name: {
                name: numbers[name] if name in numbers else to_numbers(value, use.outputs[name].code)
                for name, value in outputs.items()
            }
            for use, outputs, numbers in self.latest.values()
        }
        for region, (fired, chances) in self.heard.items():
            self.fired[region] = self.fired.get(region, 0) + self.running * fired
            self.chances[region] = self.chances.get(region, 0) + self.running * chances

    def used(
        self,
        use: Use,
        iteration: int,
        inputs: Mapping[str, Tensor],
        outputs: Mapping[str, Tensor],
        numbers: Mapping[str, Tensor],
    ) -> None:
        """Keep the inputs of a use as they came, and the outputs of its last iteration."""
        if self.keeps_values:
            self.inputs.setdefault(use.name, []).append(inputs)
            self.latest[use.name] = use, outputs, numbers

    def probe(self, use: Use, *, last: bool) -> Probe:
        """Count the spikes of a use, and keep those of its last iteration if a recorder wants them."""
        return _Probe(self, use, bool(self.most_neurons and last))

    def saturated(self, edge: Edge, count: Tensor) -> None:
        """Count the components of a value that were out of range."""
        place = f"{edge.reader}.{edge.input}"
        self.saturations[place] = self.saturations.get(place, 0) + self.running * count

    def firing_rates(self) -> dict[str, Tensor]:
        """Return spikes per neuron and step (batch) of every region that spikes."""
        return {region: fired / self.chances[region] for region, fired in self.fired.items()}
