"""The compiler: from the steps of a file to a plan, or to all the faults that stand in the way."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import lcm
from typing import Protocol

from neurorobo.clock import Clock
from neurorobo.errors import ConfigError, Fault, NeuroroboError, did_you_mean
from neurorobo.graph.plan import Edge, Plan, Reduction, Repeat, Use
from neurorobo.graph.reference import Source, parse_reference
from neurorobo.graph.spec import RepeatSpec, StepSpec
from neurorobo.regions import Port, RegionConfig
from neurorobo.regions.config import checked_ports
from neurorobo.units import UnitError, same_unit

BODY = "body"
COMMAND = "command"

Path = tuple[str | int, ...]


class Channel(Protocol):
    """What a graph needs to know of a sensor or an actuator."""

    @property
    def unit(self) -> str:
        """The unit of its components."""

    @property
    def width(self) -> int:
        """The number of its components."""


def compile_graph(
    steps: Sequence[StepSpec | RepeatSpec],
    command: Mapping[str, str],
    regions: Mapping[str, RegionConfig],
    clock: Clock,
    sensors: Mapping[str, Channel],
    actuators: Mapping[str, Channel],
) -> Plan:
    """Compile a region graph.

    Raises :class:`ConfigError` with every fault found: unknown names, missing inputs, quantities that do not fit,
    periods without a read rule, steps that read what runs after them, and cycles without a delay.
    """
    return _Compiler(regions, clock, sensors).compile(steps, command, actuators)


@dataclass(frozen=True)
class _Node:
    """A step as the compiler sees it: where it stands and what it offers."""

    name: str
    position: int
    repeat: int | None
    period: int
    outputs: Mapping[str, Port]
    path: Path


@dataclass
class _Compiler:
    regions: Mapping[str, RegionConfig]
    clock: Clock
    sensors: Mapping[str, Channel]
    ports: dict[str, tuple[Mapping[str, Port], Mapping[str, Port]]] = field(default_factory=dict)
    nodes: dict[str, _Node] = field(default_factory=dict)
    edges: list[Edge] = field(default_factory=list)
    faults: list[Fault] = field(default_factory=list)
    same_tick: dict[str, set[str]] = field(default_factory=dict)
    late: list[tuple[Path, str, Source]] = field(default_factory=list)

    def compile(
        self, steps: Sequence[StepSpec | RepeatSpec], command: Mapping[str, str], actuators: Mapping[str, Channel]
    ) -> Plan:
        for name, config in self.regions.items():
            try:
                self.ports[name] = checked_ports(config, self.clock)
            except ConfigError as error:
                self.faults += error.under("regions", name).faults
        body_ports = {name: Port(sensor.unit, sensor.width) for name, sensor in self.sensors.items()}
        self.nodes[BODY] = _Node(BODY, -1, None, 1, body_ports, (BODY,))
        position = 0
        for block, item in enumerate(steps):
            inner = item.steps if isinstance(item, RepeatSpec) else (item,)
            for step in inner:
                self._declare(step, position, block if isinstance(item, RepeatSpec) else None)
                position += 1
            if isinstance(item, RepeatSpec):
                self._check_repeat(item)
        order: list[Use | Repeat] = []
        for item in steps:
            if isinstance(item, RepeatSpec):
                uses = tuple(use for step in item.steps if (use := self._use(step)) is not None)
                if uses:
                    order.append(Repeat(item.count, uses))
            elif (use := self._use(item)) is not None:
                order.append(use)
        commands = self._commands(command, actuators)
        self._check_order()
        self._check_kept([step for item in steps for step in (item.steps if isinstance(item, RepeatSpec) else (item,))])
        if self.faults:
            raise ConfigError(self.faults)
        outgoing: dict[str, list[Edge]] = {}
        for edge in self.edges:
            outgoing.setdefault(edge.source, []).append(edge)
        hyperperiod = lcm(*(item.period for item in order)) if order else 1
        return Plan(self.clock, tuple(order), commands, {k: tuple(v) for k, v in outgoing.items()}, hyperperiod)

    def _fault(self, path: Path, message: str) -> None:
        self.faults.append(Fault(path, message))

    def _declare(self, step: StepSpec, position: int, repeat: int | None) -> None:
        if step.name in (BODY, COMMAND):
            self._fault(step.path, f"a step cannot be called `{step.name}`: the name is taken; choose another")
            return
        if step.name in self.nodes:
            self._fault(step.path, f"there is already a step `{step.name}`; give every step a name of its own")
            return
        ports = self._ports(step)
        if step.every not in self.clock.periods_ns:
            known = did_you_mean(step.every, self.clock.periods_ns)
            self._fault((*step.path, "every"), f"there is no period `{step.every}` under `time`{known}")
            period = self.clock.ticks("control")
        else:
            period = self.clock.ticks(step.every)
        outputs = {} if ports is None else ports[1]
        self.nodes[step.name] = _Node(step.name, position, repeat, period, outputs, step.path)
        if ports is not None:
            spiking = any(port.code for port in (*ports[0].values(), *outputs.values()))
            if spiking and self.clock.window_ns > period * self.clock.tick_ns:
                self._fault(
                    (*step.path, "every"),
                    f"the spike window of {self.clock.window_ns / 1e6:g} ms does not fit the period `{step.every}` of "
                    f"{period * self.clock.tick_ns / 1e6:g} ms; shorten the window or run the step less often",
                )

    def _ports(self, step: StepSpec) -> tuple[Mapping[str, Port], Mapping[str, Port]] | None:
        """Return the ports of a step's region, or note that there is no such region."""
        if step.use not in self.regions:
            known = did_you_mean(step.use, self.regions)
            self._fault((*step.path, "use"), f"there is no region `{step.use}`{known}")
        return self.ports.get(step.use)

    def _check_repeat(self, block: RepeatSpec) -> None:
        periods = {step.every for step in block.steps}
        if len(periods) > 1:
            self._fault(
                block.path, f"the steps of a repeat run together, but have the periods {', '.join(sorted(periods))}"
            )

    def _use(self, step: StepSpec) -> Use | None:
        node, known = self.nodes.get(step.name), self.ports.get(step.use)
        if node is None or node.path != step.path or known is None:
            return None
        ports, _ = known
        inputs: dict[str, tuple[Edge, ...]] = {}
        for name, text in step.inputs.items():
            path = (*step.path, name)
            if name not in ports:
                self._fault(path, f"`{step.use}` has no input `{name}`{did_you_mean(name, ports)}")
                continue
            edges = self._connect(node, name, ports[name], text, path)
            if edges:
                inputs[name] = edges
        for name, port in ports.items():
            if name not in step.inputs and port.initial is None:
                self._fault(
                    step.path,
                    f"the input `{name}` ({_describe(port)}) of `{step.use}` is not wired; add `{name}: <step>.<port>`",
                )
        defaults = {name: port for name, port in ports.items() if name not in step.inputs}
        return Use(step.name, step.use, step.state, node.period, inputs, defaults, node.outputs)

    def _commands(self, command: Mapping[str, str], actuators: Mapping[str, Channel]) -> dict[str, Edge]:
        end = _Node(COMMAND, len(self.nodes), None, 1, {}, (COMMAND,))
        commands = {}
        for name, text in command.items():
            path = (COMMAND, name)
            if name not in actuators:
                self._fault(path, f"the body has no actuator `{name}`{did_you_mean(name, actuators)}")
                continue
            port = Port(actuators[name].unit, actuators[name].width)
            edges = self._connect(end, name, port, text, path)
            if edges:
                commands[name] = edges[0]
        for name in actuators:
            if name not in command:
                self._fault((COMMAND,), f"nothing drives the actuator `{name}`; add `{name}: <step>.<port>`")
        return commands

    def _connect(self, reader: _Node, name: str, port: Port, text: str, path: Path) -> tuple[Edge, ...]:
        try:
            reference = parse_reference(text)
        except NeuroroboError as error:
            self._fault(path, str(error))
            return ()
        edges = []
        for takes_over, source in enumerate((reference.source, reference.then)):
            if source is None:
                continue
            edge = self._edge(reader, name, port, source, path, takes_over=bool(takes_over))
            if edge is None:
                return ()
            if port.once and reference.then is None and (fault := self._not_once(reader, source)) is not None:
                self._fault(path, fault)
                return ()
            edges.append(edge)
        self.edges += edges
        return tuple(edges)

    def _edge(
        self,
        reader: _Node,
        name: str,
        port: Port,
        source: Source,
        path: Path,
        *,
        takes_over: bool,
    ) -> Edge | None:
        """Resolve one source of an input, or note why it cannot be."""
        node = self.nodes.get(source.step)
        if node is None:
            self._fault(path, f"there is no step `{source.step}`{did_you_mean(source.step, self.nodes)}")
            return None
        if source.port not in node.outputs:
            if node.name == BODY and not node.outputs:
                self._fault(path, f"there is no `body` to read `{source.port}` from; declare one, or read a step")
            elif node.outputs:
                known = did_you_mean(source.port, node.outputs)
                self._fault(path, f"`{source.step}` has no output `{source.port}`{known}")
            return None
        offered = node.outputs[source.port]
        try:
            fits = same_unit(offered.unit, port.unit) and offered.width == port.width
        except UnitError as error:  # of a sensor or an actuator
            self._fault(path, str(error))
            return None
        if not fits:
            self._fault(
                path, f"`{source.step}.{source.port}` is {_describe(offered)}, but `{name}` takes {_describe(port)}"
            )
            return None
        together = reader.repeat is not None and reader.repeat == node.repeat
        runs_first = node.position < reader.position
        wording = f"then {source}" if takes_over else str(source)
        edge = Edge(
            reader=reader.name,
            input=name,
            source=source.step,
            output=source.port,
            source_port=offered,
            reader_port=port,
            wording=wording + (f" delayed {source.delay_ns / 1e6:g} ms" if source.delay_ns else ""),
            takes_over=takes_over,
            source_period=node.period,
            reader_period=reader.period,
            source_runs_first=runs_first,
        )
        needs_initial = False
        if takes_over:
            if not together:
                self._fault(path, f"`then {source}` needs a step of the same repeat; `{source.step}` is not in it")
                return None
            if not runs_first:  # it is read in the next iteration, and after the last there is none
                return replace(edge, iteration="all_but_last")
            return replace(edge, iterations_back=1, length=2)
        misuse = self._misuse(reader, node, source)
        if misuse is not None:
            self._fault(path, misuse)
            return None
        if node.repeat is not None and not together:
            edge = replace(edge, iteration="last")
        if source.delay_ns:
            delay = source.delay_ns // self.clock.tick_ns
            edge, needs_initial = replace(edge, delay=delay, length=-(-delay // node.period) + 1), True
        elif source.reading == "previous":
            needs_initial = True
            if together:
                back = int(runs_first)
                edge = replace(edge, iterations_back=back, length=back + 1, restarts_in_repeat=True)
            elif runs_first:
                edge = replace(edge, skip_this_tick=True, length=2)
        else:
            if runs_first:
                self.same_tick.setdefault(reader.name, set()).add(source.step)
            elif source.reading == "now":
                self.late.append((path, reader.name, source))
            else:
                needs_initial = True
            if source.reading == "first":
                edge = replace(edge, iteration="first")
            elif source.reading in ("sum", "mean"):
                reduction: Reduction = "sum" if source.reading == "sum" else "mean"
                edge = replace(edge, reduction=reduction, length=reader.period // node.period)
        if needs_initial and port.initial is None:
            self._fault(
                path,
                f"`{edge.wording}` has no value at the start, and the input `{name}` declares no initial one; "
                "read it without delay",
            )
            return None
        return edge

    def _misuse(self, reader: _Node, node: _Node, source: Source) -> str | None:
        """Say what is wrong with the way in which a source is read, if anything."""
        plain = f"{source.step}.{source.port}"
        word = "delayed" if source.delay_ns else source.reading
        if reader.name == COMMAND and word not in ("now", "first"):
            return f"a command takes the value of its tick, so `{word}` cannot stand here; write `{plain}`"
        if reader.repeat is not None and reader.repeat == node.repeat and word in ("delayed", "sum", "mean"):
            return (
                f"`{source.step}` is in the same repeat, all at one time, so `{word}` cannot be meant; "
                f"write `{plain}` or `previous {plain}`"
            )
        if source.delay_ns % self.clock.tick_ns:
            return (
                f"a delay of {source.delay_ns / 1e6:g} ms is not a multiple of the tick "
                f"of {self.clock.tick_ns / 1e6:g} ms"
            )
        if word == "first" and node.repeat is None:
            return f"`first` reads the first iteration of a repeat, and `{source.step}` is in none; leave it out"
        if word in ("last", "sum", "mean") and node.period > reader.period:
            return f"`{source.step}` runs less often than its reader, which sees its value held; write `{plain}`"
        if word in ("now", "last", "sum", "mean") and reader.period % node.period and node.period < reader.period:
            return (
                f"the period of `{source.step}` does not divide that of its reader; choose periods that do, "
                f"or read `previous {plain}`"
            )
        if word == "now" and node.period < reader.period and node.name != BODY:
            return (
                f"`{source.step}` runs {reader.period // node.period} times as often as its reader; "
                f"say which value is meant: `last {plain}`, `sum {plain}` or `mean {plain}`"
            )
        return None

    def _not_once(self, reader: _Node, source: Source) -> str | None:
        """Say why an input that adds up what it hears would not hear each window of its source once, if so."""
        node = self.nodes[source.step]
        plain = f"{source.step}.{source.port}"
        if node.period > reader.period or reader.repeat not in (None, node.repeat):
            return (
                f"`{reader.name}` runs more often than `{source.step}` and would add the same change again each time; "
                "run both equally often"
            )
        if node.repeat != reader.repeat:
            return f"`{reader.name}` would miss iterations of `{source.step}`; put both into the same repeat"
        if node.period < reader.period and source.reading != "sum":
            return (
                f"`{source.step}` runs {reader.period / node.period:g} times as often as `{reader.name}`, which would "
                f"miss changes; write `sum {plain}`"
            )
        return None

    def _check_kept(self, steps: Sequence[StepSpec]) -> None:
        """Report every region that is nothing without its past and whose state no step commits."""
        for name, config in self.regions.items():
            uses = [step for step in steps if step.use == name]
            if config.accumulates and uses and all(step.state != "commit" for step in uses):
                self._fault(
                    (*uses[0].path, "state"),
                    f"no step keeps the state of `{name}`, so that what it learns or adds up is lost each time; leave "
                    "`state` out of a step that uses it",
                )

    def _check_order(self) -> None:
        """Report every step that reads, in the same tick, what runs after it."""
        for path, reader, source in self.late:
            if reader == source.step:
                self._fault(path, f"`{reader}` reads its own output without a delay; write `previous {source}`")
                continue
            chain = self._chain(source.step, reader)
            if chain is None:
                self._fault(
                    path,
                    f"`{source.step}` runs after `{reader}`; "
                    f"move `{source.step}` up, or read its last value: `previous {source}`",
                )
            else:
                loop = " -> ".join((*reversed(chain), chain[-1]))
                self._fault(path, f"a cycle without delay: {loop}; read one of its edges with `previous`")

    def _chain(self, start: str, goal: str) -> list[str] | None:
        """Return a path of same-tick reads from ``start`` to ``goal``, depth first."""
        late = {(reader, source.step) for _, reader, source in self.late}
        stack, seen = [[start]], {start}
        while stack:
            chain = stack.pop()
            if chain[-1] == goal:
                return chain
            sources = self.same_tick.get(chain[-1], set()) | {s for r, s in late if r == chain[-1]}
            for source in sorted(sources - seen):
                seen.add(source)
                stack.append([*chain, source])
        return None


def _describe(port: Port) -> str:
    return f"{port.width} x {port.unit}" if port.width > 1 else port.unit
