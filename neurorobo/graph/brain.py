"""The brain: a plan and its regions, run tick by tick on an explicit state."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import torch
from torch import Tensor, nn

from neurorobo.codes import Code
from neurorobo.errors import NeuroroboError
from neurorobo.graph.compile import BODY
from neurorobo.graph.plan import Edge, Plan, Repeat, Use
from neurorobo.regions.port import Port
from neurorobo.regions.region import Probe, Region, State
from neurorobo.regions.values import from_numbers, initial_value, to_numbers

_PREFIX = "region_"


class Observer(Protocol):
    """Watches a brain at work; it may not change anything."""

    def used(
        self,
        use: Use,
        iteration: int,
        inputs: Mapping[str, Tensor],
        outputs: Mapping[str, Tensor],
        numbers: Mapping[str, Tensor],
    ) -> None:
        """Take the inputs and the outputs of one use of a region, in the form that their ports carry.

        ``numbers`` are those outputs that had to be decoded for what reads them, as numbers (batch, width).
        """

    def probe(self, use: Use, *, last: bool) -> Probe | None:
        """Return what should listen to the spikes inside this use, if anything.

        ``last`` tells whether the use runs no more in this tick.
        """

    def saturated(self, edge: Edge, count: Tensor) -> None:
        """Take how many components of a value, ``count`` (batch), were out of the range of the code they went into.

        Called each time that an edge encodes or recodes what is out of range for any member of the batch; a sensor's
        value is encoded only where it is read.
        """


@dataclass(frozen=True)
class BrainState:
    """All that a brain remembers between ticks: region states, edge buffers, time, and the states of its generators.

    ``buffers`` holds for each edge its last values, oldest first, each (batch, width) or (steps, batch, neurons);
    where values are added up, each has one more column that counts them: 0 before the source has spoken, then 1.
    """

    tick: int
    batch: int
    regions: Mapping[str, State]
    buffers: Mapping[str, tuple[Tensor, ...]]
    random: Tensor

    def tensors(self) -> dict[str, Tensor]:
        """Return the state as named tensors that share no memory, as safetensors wants them.

        ``safetensors.torch.save_file(state.tensors(), path)`` writes a checkpoint,
        ``BrainState.from_tensors(safetensors.torch.load_file(path))`` is the state that was written.
        """
        regions = {
            f"region/{name}/{key}": value for name, state in self.regions.items() for key, value in state.items()
        }
        buffers = {f"edge/{name}/{i}": value for name, values in self.buffers.items() for i, value in enumerate(values)}
        clock = {"tick": torch.tensor(self.tick), "batch": torch.tensor(self.batch), "random": self.random}
        named = {**clock, **regions, **buffers}
        return {name: value.clone(memory_format=torch.contiguous_format) for name, value in named.items()}

    @classmethod
    def from_tensors(cls, tensors: Mapping[str, Tensor]) -> "BrainState":
        """Rebuild a state from its named tensors."""
        regions: dict[str, State] = {}
        buffers: dict[str, dict[int, Tensor]] = {}
        for name, value in tensors.items():
            kind, *path = name.split("/", 2)
            if kind == "region":
                regions.setdefault(path[0], {})[path[1]] = value
            elif kind == "edge":
                buffers.setdefault(path[0], {})[int(path[1])] = value
        ordered = {name: tuple(values[i] for i in sorted(values)) for name, values in buffers.items()}
        return cls(int(tensors["tick"]), int(tensors["batch"]), regions, ordered, tensors["random"])


class Brain(nn.Module):
    """A compiled region graph: the same object is trained, run in simulation, and run on a robot."""

    regions: nn.ModuleDict

    def __init__(self, plan: Plan, regions: Mapping[str, Region]) -> None:
        """Join a plan with the regions that it names."""
        super().__init__()
        self.plan = plan
        self.names = tuple(regions)
        # torch refuses the names of a module's own attributes, such as `train`
        self.regions = nn.ModuleDict({_PREFIX + name: region for name, region in regions.items()})
        self._regions = dict(regions)  # the same, found in less time
        self._initial_values: dict[tuple[Port, int], Tensor] = {}

    def region(self, name: str) -> Region:
        """Return a region by name."""
        return self._regions[name]

    def init_state(self, seeds: Sequence[int]) -> BrainState:
        """Return the state at the start of independent runs, one for each seed; it starts the run's own generator.

        Only stochastic codes draw from it, and no run from another's, so that a run does not depend on its batch.
        """
        batch = len(seeds)
        generators = [torch.Generator().manual_seed(seed) for seed in seeds] if self.plan.stochastic else []
        regions = {name: self.region(name).init_state(batch) for name in self.names}
        buffers = {edge.name: self._initial(edge, batch, generators) for edge in self.plan.edges()}
        return BrainState(0, batch, regions, buffers, _states(generators, batch))

    def reset(self, state: BrainState, which: Tensor, seeds: Sequence[int]) -> BrainState:
        """Return ``state`` with the runs where ``which`` (batch, bool) at their start again; the time goes on.

        ``seeds`` has one for every run of the batch; those of runs that go on are not used. Raises NeuroroboError where
        a run cannot start: inside a hyperperiod, as not every step runs then.
        """
        if state.tick % self.plan.hyperperiod:
            raise NeuroroboError(
                f"a run cannot start at tick {state.tick}, where some steps do not run; "
                f"reset at a multiple of the hyperperiod of {self.plan.hyperperiod} ticks"
            )
        start = self.init_state(seeds)

        def mixed(old: Tensor, new: Tensor, batch_dimension: int) -> Tensor:
            shape = [1] * old.dim()
            shape[batch_dimension] = -1
            return torch.where(which.view(shape), new, old)

        return replace(
            state,
            random=mixed(state.random, start.random, 0),
            regions={n: {k: mixed(v, start.regions[n][k], 0) for k, v in s.items()} for n, s in state.regions.items()},
            buffers={
                name: tuple(
                    mixed(old, new, old.dim() - 2) for old, new in zip(values, start.buffers[name], strict=True)
                )
                for name, values in state.buffers.items()
            },
        )

    def tick(
        self, observation: Mapping[str, Tensor], state: BrainState, observer: Observer | None = None
    ) -> tuple[dict[str, Tensor], BrainState]:
        """Run everything that is due at ``state.tick``.

        ``observation`` maps each sensor to numbers (batch, width). Returns the commands that are due (batch, width)
        by actuator, and the next state. ``state`` itself is left as it was. Raises NeuroroboError if the observation
        lacks a sensor that is read, or has another shape.
        """
        for edge in self.plan.outgoing.get(BODY, ()):
            shape = (state.batch, edge.source_port.width)
            if edge.output not in observation:
                raise NeuroroboError(f"the observation lacks the sensor `{edge.output}`, which `{edge.reader}` reads")
            if observation[edge.output].shape != shape:
                raise NeuroroboError(
                    f"the sensor `{edge.output}` gives the shape {tuple(observation[edge.output].shape)}; "
                    f"this state and this plan need {shape}: runs, components"
                )
        moment = _Moment(self, state, observer)
        moment.push(BODY, observation)
        for item in self.plan.due(state.tick):
            if isinstance(item, Repeat):
                moment.run_repeat(item)
            else:
                moment.run_alone(item)
        commands = {
            name: moment.read(edge) for name, edge in self.plan.command.items() if state.tick % edge.source_period == 0
        }
        return commands, moment.end()

    def _initial(self, edge: Edge, batch: int, generators: Sequence[torch.Generator]) -> tuple[Tensor, ...]:
        """Return the values of an edge before its source has spoken; none where the source always speaks first."""
        if edge.reduction != "newest":
            return (torch.zeros(batch, edge.reader_port.width + 1),) * edge.length
        value = self._initial_value(edge.reader_port, batch, generators).clone()  # the kept one is nobody's to change
        return (value,) * edge.length

    def _initial_value(self, port: Port, batch: int, generators: Sequence[torch.Generator]) -> Tensor:
        """Return the initial value of a port; but for stochastic codes, it is made once for each size of batch."""
        if port.code is not None and port.code.stochastic:
            return initial_value(port, batch, self.plan.clock.window, generators)
        value = self._initial_values.get((port, batch))
        if value is None:
            with torch.inference_mode(False):
                value = initial_value(port, batch, self.plan.clock.window, generators)
            self._initial_values[port, batch] = value
        return value


def _states(generators: Sequence[torch.Generator], batch: int) -> Tensor:
    """Return the states of a batch's generators as one tensor, a row for each; empty rows if there are none."""
    if not generators:
        return torch.empty(batch, 0, dtype=torch.uint8)
    return torch.stack([generator.get_state() for generator in generators])


def _restored(states: Tensor) -> list[torch.Generator]:
    """Return generators that go on from their states."""
    if states.shape[1] == 0:
        return []
    generators = [torch.Generator() for _ in states]
    for generator, state in zip(generators, states, strict=True):
        generator.set_state(state.clone())  # it reads the storage from its start
    return generators


@dataclass
class _Moment:
    """One tick in the making: working copies of what may change.

    ``forks`` holds the state of each forked use, ``block`` that of each region with ``carry: repeat``; both are those
    of the repeat that is running.
    """

    brain: Brain
    state: BrainState
    observer: Observer | None
    regions: dict[str, State] = field(init=False)
    buffers: dict[str, tuple[Tensor, ...]] = field(init=False)
    generators: list[torch.Generator] = field(init=False)
    forks: dict[str, State] = field(default_factory=dict)
    block: dict[str, State] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.regions = dict(self.state.regions)
        self.buffers = dict(self.state.buffers)
        self.generators = _restored(self.state.random)
        self.steps = self.brain.plan.clock.window

    def end(self) -> BrainState:
        """Return the state after this tick."""
        return replace(
            self.state,
            tick=self.state.tick + 1,
            regions=self.regions,
            buffers=self.buffers,
            random=_states(self.generators, self.state.batch),
        )

    def push(
        self, source: str, outputs: Mapping[str, Tensor], *, first: bool = True, last: bool = True
    ) -> dict[str, Tensor]:
        """Put new values of a source into its edges, and return those outputs that were decoded for it.

        ``first`` and ``last`` tell the iteration of its repeat.
        """
        decoded: dict[str, Tensor] = {}  # once for all edges that read an output
        for edge in self.brain.plan.outgoing.get(source, ()):
            if source == BODY and not edge.reads_sensor_at(self.state.tick):
                continue
            when = edge.iteration
            if when != "every" and (
                (when == "first" and not first) or (when == "last" and not last) or (when == "all_but_last" and last)
            ):
                continue
            if edge.output not in outputs:
                raise NeuroroboError(f"`{source}` did not give `{edge.output}`, which `{edge.reader}` reads")
            value = outputs[edge.output]
            if edge.conversion or edge.reduction != "newest":
                numbers = decoded.get(edge.output)
                if numbers is None:
                    numbers = decoded[edge.output] = to_numbers(value, edge.source_port.code)
                if edge.reduction == "newest":
                    value = self.encoded(edge, numbers, edge.source_port.code)
                else:
                    value = torch.cat([numbers, torch.ones(self.state.batch, 1)], dim=1)
            self.buffers[edge.name] = (*self.buffers[edge.name][1:], value)
        return decoded

    def read(self, edge: Edge) -> Tensor:
        """Take the value that an edge's reader sees now."""
        values = self.buffers[edge.name]
        if edge.reduction == "newest":
            return values[-1 - edge.offset(self.state.tick)]
        total = torch.stack(values).sum(0)
        total, count = total[:, :-1], total[:, -1:]
        if edge.reduction == "mean":
            total = total / count.clamp(min=1)
        start = initial_value(replace(edge.reader_port, code=None), self.state.batch, self.steps, self.generators)
        return self.encoded(edge, torch.where(count > 0, total, start), None)

    def encoded(self, edge: Edge, numbers: Tensor, source: Code | None) -> Tensor:
        """Bring numbers, perhaps decoded from ``source``, to what is read; tell the observer what saturates."""
        target = edge.reader_port.code
        if self.observer is not None and target is not None and edge.can_saturate and target.may_saturate(numbers):
            # A decoded value may leave its own code's range by a rounding, and that does not count.
            inside = numbers if source is None else numbers.clamp(source.lo, source.hi)
            outside = target.saturated(inside).sum(1)
            if outside.any():
                self.observer.saturated(edge, outside)
        return from_numbers(numbers, target, self.steps, self.generators)

    def run_repeat(self, block: Repeat) -> None:
        """Run a block of uses several times; the states of its forks and of ``carry: repeat`` live and end with it."""
        names = {use.name for use in block.uses}
        for use in block.uses:
            for edge in self.brain.plan.outgoing.get(use.name, ()):
                if edge.restarts_in_repeat and edge.reader in names:
                    self.buffers[edge.name] = self.brain._initial(edge, self.state.batch, self.generators)
        self.forks, self.block = {}, {}
        for iteration in range(block.count):
            for use in block.uses:
                self.run(use, iteration, last=iteration == block.count - 1)

    def run_alone(self, use: Use) -> None:
        """Run a use outside any repeat."""
        self.forks, self.block = {}, {}
        self.run(use, 0, last=True)

    def run(self, use: Use, iteration: int, *, last: bool) -> None:
        """Run one use: gather its inputs, step its region, keep or drop the new state, publish the outputs."""
        region = self.brain.region(use.region)
        inputs = {name: self.read(edges[min(iteration, len(edges) - 1)]) for name, edges in use.inputs.items()}
        for name, port in use.defaults.items():
            inputs[name] = self.brain._initial_value(port, self.state.batch, self.generators).clone()
        probe = None if self.observer is None else self.observer.probe(use, last=last)
        outputs, after = region.step(inputs, self._state_before(use, region), probe)
        if use.policy == "fork":
            self.forks[use.name] = after
        elif use.policy == "commit" and region.config.carry == "repeat":
            self.block[use.region] = after
        elif use.policy == "commit" and region.config.carry == "always":
            self.regions[use.region] = after
        numbers = self.push(use.name, outputs, first=iteration == 0, last=last)
        if self.observer is not None:
            self.observer.used(use, iteration, inputs, outputs, numbers)

    def _state_before(self, use: Use, region: Region) -> State:
        """Return the state a use starts from, by its policy and by how long the region carries its state."""
        carry = region.config.carry
        if use.policy == "fresh" or carry == "never":
            return region.init_state(self.state.batch)
        if use.name in self.forks:
            return self.forks[use.name]
        if carry == "always":
            return self.regions.get(use.region, {})  # a region without state leaves no trace in a checkpoint
        return self.block.get(use.region) or region.init_state(self.state.batch)
