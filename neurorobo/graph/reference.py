"""References: the words by which a step's input names its source.

``plan.speed``, ``previous plan.speed``, ``first remember.mean``, ``mean act.move``, ``body.force delayed 200 ms``,
and in a repeat ``body.force then imagine.forecast``.
"""

import re
from dataclasses import dataclass, replace
from typing import Literal, cast, get_args

from neurorobo.errors import NeuroroboError
from neurorobo.units import parse_duration_ns

Reading = Literal["now", "previous", "first", "last", "sum", "mean"]

_GRAMMAR = (
    "`step.port`, `previous | first | last | sum | mean step.port` or `step.port delayed <duration>`, "
    "and after it, in a repeat, `then step.port`"
)
_SOURCE = re.compile(r"(?:(\w+)\s+)?([A-Za-z]\w*)\.([A-Za-z]\w*)(?:\s+delayed\s+(.+))?")


@dataclass(frozen=True)
class Source:
    """One end of a reference: a port of a step or of the body, how to read it, and how long ago."""

    step: str
    port: str
    reading: Reading = "now"
    delay_ns: int = 0

    def __str__(self) -> str:
        """Return the reference as it is written, without its delay."""
        return f"{self.step}.{self.port}" if self.reading == "now" else f"{self.reading} {self.step}.{self.port}"


@dataclass(frozen=True)
class Reference:
    """Where an input comes from; ``then``, in a repeat, replaces ``source`` from the second iteration on."""

    source: Source
    then: Source | None = None


def parse_reference(text: str) -> Reference:
    """Parse a reference; raise :class:`NeuroroboError` with the grammar if it does not follow it."""
    parts = [part.strip() for part in re.split(r"\bthen\b", text)]
    if len(parts) > 2:
        raise NeuroroboError(f"'{text}' says `then` more than once; write {_GRAMMAR}")
    reference = Reference(*(_parse_source(part) for part in parts))
    then = reference.then
    if then is not None and parts[1] != str(replace(then, reading="now")):
        raise NeuroroboError(
            f"'{text}' has more than a step and a port after `then`, which always reads the iteration before; "
            f"write `then {then.step}.{then.port}`"
        )
    return reference


def _parse_source(text: str) -> Source:
    match = _SOURCE.fullmatch(text)
    if match is None:
        raise NeuroroboError(f"'{text}' is not a reference; write {_GRAMMAR}")
    reading, step, port, delay = match.groups()
    words = [word for word in get_args(Reading) if word != "now"]
    if reading is not None and reading not in words:
        raise NeuroroboError(f"'{reading}' is not a way to read {step}.{port}; allowed: {', '.join(words)}")
    if reading is not None and delay is not None:
        raise NeuroroboError(
            f"'{text}' says both `{reading}` and `delayed`; write `{reading} {step}.{port}` or "
            f"`{step}.{port} delayed {delay}`"
        )
    return Source(step, port, cast(Reading, reading or "now"), 0 if delay is None else parse_duration_ns(delay))
