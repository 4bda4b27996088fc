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
from neurorobo.regions import Port
from neurorobo.regions.region import Probe, Region, State


class Observer(Protocol):
    """Watches a brain at work; it may not change anything."""

    def used(self, use: Use, iteration: int, outputs: Mapping[str, Tensor]) -> None:
        """Take the outputs of one use of a region."""

    def probe(self, use: Use) -> Probe | None:
        """Return what should listen to the spikes inside this use, if anything."""


@dataclass(frozen=True)
class BrainState:
    """All that a brain remembers between ticks: region states, edge buffers, time, and the states of its generators.

    ``buffers`` holds for each edge its last values, oldest first, each (batch, width) or (steps, batch, neurons).
    """

    tick: int
    batch: int
    regions: Mapping[str, State]
    buffers: Mapping[str, tuple[Tensor, ...]]
    random: Tensor

    def detach(self) -> "BrainState":
        """Return the same state, cut off from the graph of gradients."""
        return replace(
            self,
            regions={
                name: {key: value.detach() for key, value in state.items()} for name, state in self.regions.items()
            },
            buffers={name: tuple(value.detach() for value in values) for name, values in self.buffers.items()},
        )

    def tensors(self) -> dict[str, Tensor]:
        """Return the state as named tensors, for a checkpoint; :meth:`from_tensors` is its inverse."""
        regions = {
            f"region/{name}/{key}": value for name, state in self.regions.items() for key, value in state.items()
        }
        buffers = {f"edge/{name}/{i}": value for name, values in self.buffers.items() for i, value in enumerate(values)}
        clock = {"tick": torch.tensor(self.tick), "batch": torch.tensor(self.batch), "random": self.random}
        return {**clock, **regions, **buffers}

    @classmethod
    def from_tensors(cls, tensors: Mapping[str, Tensor]) -> "BrainState":
        """Rebuild a state from its named tensors."""
        regions: dict[str, State] = {}
        buffers: dict[str, dict[int, Tensor]] = {}
        for name, value in tensors.items():
            kind, *path = name.split("/")
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
        self.regions = nn.ModuleDict(dict(regions))

    def region(self, name: str) -> Region:
        """Return a region by name."""
        region = self.regions[name]
        assert isinstance(region, Region)
        return region

    def init_state(self, seeds: Sequence[int]) -> BrainState:
        """Return the state at the start of independent runs, one for each seed; it starts the run's own generator.

        Only stochastic codes draw from it, and no run from another's, so that a run does not depend on its batch.
        """
        batch = len(seeds)
        generators = [torch.Generator().manual_seed(seed) for seed in seeds] if self.plan.stochastic else []
        regions = {name: self.region(name).init_state(batch) for name in self.regions}
        buffers = {edge.name: self._initial(edge, batch, generators) for edge in self.plan.edges()}
        return BrainState(0, batch, regions, buffers, _states(generators, batch))

    def reset(self, state: BrainState, which: Tensor, seeds: Sequence[int]) -> BrainState:
        """Return ``state`` with the runs where ``which`` (batch, bool) at their start again; the time goes on.

        ``seeds`` has one for every run of the batch; those of runs that go on are not used.
        """
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
        by actuator, and the next state. ``state`` itself is left as it was.
        """
        moment = _Moment(self, state, observer)
        moment.push(BODY, observation)
        for item in self.plan.due(state.tick):
            if isinstance(item, Repeat):
                moment.run_repeat(item)
            else:
                moment.run(item, 0, {})
        commands = {
            name: moment.read(edge) for name, edge in self.plan.command.items() if state.tick % edge.source_period == 0
        }
        return commands, moment.end()

    def _initial(self, edge: Edge, batch: int, generators: Sequence[torch.Generator]) -> tuple[Tensor, ...]:
        """Return the values of an edge before its source has spoken; none where the source always speaks first."""
        value = initial_value(_stored_port(edge), batch, self.plan.clock.window, generators)
        return (value,) * edge.length


def initial_value(port: Port, batch: int, steps: int, generators: Sequence[torch.Generator]) -> Tensor:
    """Return the initial value of a port in the form that it carries; zero, or silence, where it declares none."""
    if port.initial is None:
        return torch.zeros((batch, port.width) if port.code is None else (steps, batch, port.channels))
    return convert(torch.tensor(port.initial).expand(batch, -1), None, port.code, steps, generators)


def convert(
    value: Tensor, source: Code | None, target: Code | None, steps: int, generators: Sequence[torch.Generator]
) -> Tensor:
    """Bring a value from one code to another; ``None`` stands for numbers. Recoding counts, requantises and re-emits.

    A stochastic code draws the spikes of each run of the batch from the run's own generator.
    """
    if source == target:
        return value
    numbers = value if source is None else source.decode(value)
    if target is None:
        return numbers
    if not target.stochastic:
        return target.encode(numbers, steps)
    rows = zip(numbers.split(1), generators, strict=True)
    return torch.cat([target.encode(row, steps, generator) for row, generator in rows], dim=1)


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


def _stored_port(edge: Edge) -> Port:
    """An edge keeps values as its reader wants them; where it has to add them up first, as numbers."""
    return edge.reader_port if edge.reduction == "newest" else replace(edge.reader_port, code=None)


@dataclass
class _Moment:
    """One tick in the making: working copies of what may change."""

    brain: Brain
    state: BrainState
    observer: Observer | None
    regions: dict[str, State] = field(init=False)
    buffers: dict[str, tuple[Tensor, ...]] = field(init=False)
    generators: list[torch.Generator] = field(init=False)

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

    def push(self, source: str, outputs: Mapping[str, Tensor], iteration: int = 0) -> None:
        """Put new values of a source into its edges."""
        for edge in self.brain.plan.outgoing.get(source, ()):
            if edge.first_iteration_only and iteration > 0:
                continue
            if edge.output not in outputs:
                raise NeuroroboError(f"`{source}` did not give `{edge.output}`, which `{edge.reader}` reads")
            stored = _stored_port(edge).code
            value = convert(outputs[edge.output], edge.source_port.code, stored, self.steps, self.generators)
            self.buffers[edge.name] = (*self.buffers[edge.name][1:], value)

    def read(self, edge: Edge) -> Tensor:
        """Take the value that an edge's reader sees now."""
        values = self.buffers[edge.name]
        if edge.reduction == "newest":
            return values[-1 - edge.offset(self.state.tick)]
        total = torch.stack(values).sum(0)
        if edge.reduction == "mean":
            total = total / edge.length
        return convert(total, None, edge.reader_port.code, self.steps, self.generators)

    def run_repeat(self, block: Repeat) -> None:
        """Run a block of uses several times; its forked states live and end with it."""
        names = {use.name for use in block.uses}
        for use in block.uses:
            for edge in self.brain.plan.outgoing.get(use.name, ()):
                if edge.restarts_in_repeat and edge.reader in names:
                    self.buffers[edge.name] = self.brain._initial(edge, self.state.batch, self.generators)
        forked: dict[str, State] = {}
        for iteration in range(block.count):
            for use in block.uses:
                self.run(use, iteration, forked)

    def run(self, use: Use, iteration: int, forked: dict[str, State]) -> None:
        """Run one use: gather its inputs, step its region, keep or drop the new state, publish the outputs."""
        region = self.brain.region(use.region)
        inputs = {name: self.read(edges[min(iteration, len(edges) - 1)]) for name, edges in use.inputs.items()}
        for name, port in use.defaults.items():
            inputs[name] = initial_value(port, self.state.batch, self.steps, self.generators)
        probe = None if self.observer is None else self.observer.probe(use)
        outputs, after = region.step(inputs, self._state_before(use, region, forked), probe)
        if use.policy == "fork" or region.config.carry == "repeat":
            forked[use.region] = after
        elif use.policy == "commit" and region.config.carry == "always":
            self.regions[use.region] = after
        self.push(use.name, outputs, iteration)
        if self.observer is not None:
            self.observer.used(use, iteration, outputs)

    def _state_before(self, use: Use, region: Region, forked: dict[str, State]) -> State:
        """Return the state a use starts from, by its policy and by how long the region carries its state."""
        carry = region.config.carry
        if use.policy == "fresh" or carry == "never":
            return region.init_state(self.state.batch)
        if use.region in forked:
            return forked[use.region]
        return self.regions[use.region] if carry == "always" else region.init_state(self.state.batch)
