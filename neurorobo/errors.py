"""Faults that the user can cure, as one family of errors; anything else that is raised is a defect of the program."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from difflib import get_close_matches


class NeuroroboError(Exception):
    """A fault that the user can cure; the text names the place, the fault and the cure."""


@dataclass(frozen=True)
class Fault:
    """One fault of a configuration: its path in the document, e.g. ``("regions", "cortex", "size")``, what is wrong."""

    path: tuple[str | int, ...]
    message: str

    def __str__(self) -> str:
        """Return ``regions.cortex.size: message``."""
        return f"{dotted(self.path)}: {self.message}" if self.path else self.message


class ConfigError(NeuroroboError):
    """All faults of a configuration at once; ``lines`` are the same faults with their places in the file, if known."""

    def __init__(self, faults: Iterable[Fault], lines: Iterable[str] | None = None) -> None:
        self.faults = tuple(faults)
        super().__init__("\n".join(map(str, self.faults) if lines is None else lines))

    def __reduce__(self) -> tuple[type["ConfigError"], tuple[tuple[Fault, ...], list[str]]]:
        """Return what another process needs to raise the same error."""
        return ConfigError, (self.faults, [str(self)])

    def under(self, *path: str | int) -> "ConfigError":
        """Return the same faults one or more levels further down the document."""
        return ConfigError(replace(fault, path=(*path, *fault.path)) for fault in self.faults)


def dotted(path: Iterable[str | int]) -> str:
    """Return a path as it is written in messages and in ``--set``: ``steps.0.plan.use``."""
    return ".".join(map(str, path))


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return ``; did you mean `x`?`` for the nearest known names, else the list of them, as the end of a message."""
    names = sorted(known)
    near = get_close_matches(word, names, n=3, cutoff=0.6)
    if near:
        return f"; did you mean {' or '.join(f'`{name}`' for name in near)}?"
    return f"; there are: {', '.join(names)}" if names else ""
