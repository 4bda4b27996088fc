"""The plan: a region graph compiled to a total order of uses, with every edge resolved."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

from neurorobo.clock import Clock
from neurorobo.regions import Port

StatePolicy = Literal["commit", "fork", "fresh"]
Iteration = Literal["every", "first", "last", "all_but_last"]
Reduction = Literal["newest", "sum", "mean"]


@dataclass(frozen=True)
class Edge:
    """A connection from a source to one input, and the buffer that belongs to it.

    The source pushes each new value, converted to the reader's form; the reader takes the value ``offset(tick)``
    places behind the newest. ``length`` values are kept, all of them ``initial`` at the start. A source in a repeat
    pushes in the iteration that ``iteration`` says. All counts of time are in ticks.
    """

    reader: str
    input: str
    source: str
    output: str
    source_port: Port
    reader_port: Port
    wording: str
    takes_over: bool = False
    length: int = 1
    source_period: int = 1
    reader_period: int = 1
    source_runs_first: bool = True
    skip_this_tick: bool = False
    delay: int = 0
    reduction: Reduction = "newest"
    iteration: Iteration = "every"
    iterations_back: int = 0
    restarts_in_repeat: bool = False

    @cached_property
    def name(self) -> str:
        """The key of the edge's buffer in the state."""
        return f"{self.reader}.{self.input}" + (" then" if self.takes_over else "")

    @cached_property
    def conversion(self) -> Literal["", "encode", "decode", "recode"]:
        """What happens to a value on its way, so that it can be seen in the printed plan."""
        source, reader = self.source_port.code, self.reader_port.code
        if source == reader:
            return ""
        if source is None:
            return "encode"
        return "decode" if reader is None else "recode"

    @cached_property
    def can_saturate(self) -> bool:
        """Whether a value may be out of the range of the code that it is brought to."""
        source, reader = self.source_port.code, self.reader_port.code
        if source is None or reader is None or self.reduction == "sum":
            return reader is not None
        return source.lo < reader.lo or source.hi > reader.hi

    def reads_sensor_at(self, tick: int) -> bool:
        """Return whether the reader may ever see what a sensor, the source, reports at ``tick``.

        It does not if it keeps the newest value alone and does not run at this tick.
        """
        return self.length > 1 or tick % self.reader_period == 0

    def offset(self, tick: int) -> int:
        """Return how many places behind the newest value the reader finds its own."""
        if self.delay:
            pushed = tick // self.source_period + 1 if self.source_runs_first else -(-tick // self.source_period)
            return pushed - 1 - (tick - self.delay) // self.source_period
        if self.skip_this_tick:
            return int(tick % self.source_period == 0)
        return self.iterations_back


@dataclass(frozen=True)
class Use:
    """One invocation of a region: which state it starts from and where each input comes from.

    ``inputs`` holds, per input port, the edge to read; inside a repeat a second edge may take over from the second
    iteration on. ``defaults`` are the inputs left unwired, which carry their initial values.
    """

    name: str
    region: str
    policy: StatePolicy
    period: int
    inputs: Mapping[str, tuple[Edge, ...]]
    defaults: Mapping[str, Port]
    outputs: Mapping[str, Port]


@dataclass(frozen=True)
class Repeat:
    """A block of uses that runs ``count`` times within one tick."""

    count: int
    uses: tuple[Use, ...]

    @property
    def period(self) -> int:
        """The period of the block, shared by its uses."""
        return self.uses[0].period


@dataclass(frozen=True)
class Plan:
    """The order of uses over a hyperperiod, and the edges into the commands.

    ``outgoing`` lists for every source (a step or ``body``) the edges that it feeds.
    """

    clock: Clock
    order: tuple[Use | Repeat, ...]
    command: Mapping[str, Edge]
    outgoing: Mapping[str, tuple[Edge, ...]]
    hyperperiod: int

    def uses(self) -> Iterator[Use]:
        """Yield every use once, in order."""
        for item in self.order:
            yield from item.uses if isinstance(item, Repeat) else (item,)

    def edges(self) -> Iterator[Edge]:
        """Yield every edge once."""
        for edges in self.outgoing.values():
            yield from edges

    @property
    def stochastic(self) -> bool:
        """Whether any edge draws spikes at random."""
        codes = (code for edge in self.edges() for code in (edge.source_port.code, edge.reader_port.code))
        defaults = (port.code for use in self.uses() for port in use.defaults.values())
        return any(code is not None and code.stochastic for code in (*codes, *defaults))

    def due(self, tick: int) -> Iterator[Use | Repeat]:
        """Yield what runs at ``tick``, in order."""
        return (item for item in self.order if tick % item.period == 0)
