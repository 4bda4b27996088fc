"""A row of the reproduction: what is measured, and how it is shown."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Result = Mapping[str, Any]
"""What a cell measured; it must survive JSON."""


@dataclass(frozen=True)
class Table:
    """Figures side by side, under ``heads``."""

    heads: Sequence[str]
    lines: Sequence[Sequence[str]]
    caption: str = ""


@dataclass(frozen=True)
class Picture:
    """A figure, drawn when it is needed; ``name`` is that of its files."""

    name: str
    caption: str
    draw: Callable[["Figure"], None]
    inches: tuple[float, float] = (7.0, 4.0)


@dataclass(frozen=True)
class Presentation:
    """How a row is shown: words in Markdown, tables, pictures, and in words what is missed of what is wanted."""

    words: Sequence[str] = ()
    tables: Sequence[Table] = ()
    pictures: Sequence[Picture] = ()
    misses: Sequence[str] = ()


@dataclass(frozen=True)
class Setting:
    """What every cell is told: the folder of the examples, and whether to try things out on a small scale."""

    examples: Path
    quick: bool = False


class Row(ABC):
    """One figure or table of the paper, or one claim beyond it.

    Its ``cells`` are measured one by one, in any order and in processes of their own with one thread each, and are kept
    one by one. ``minutes`` is what all of them take on two cores.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    paper: ClassVar[str]
    minutes: ClassVar[float]

    @abstractmethod
    def cells(self, setting: Setting) -> Sequence[str]:
        """Return the names of the cells."""

    @abstractmethod
    def measure(self, cell: str, setting: Setting) -> Result:
        """Measure one cell; deterministic."""

    @abstractmethod
    def present(self, results: Mapping[str, Result], setting: Setting) -> Presentation:
        """Show the results of all cells, by name."""

    def files(self, setting: Setting) -> Sequence[Path]:
        """Return the files that the results depend on besides the code, such as examples and weights."""
        return ()


@dataclass
class Wanted:
    """Collects what is missed."""

    misses: list[str] = field(default_factory=list)

    def at_most(self, what: str, found: float, most: float) -> None:
        """Note a figure that is larger than wanted."""
        if not found <= most:
            self.misses.append(f"{what} is {found:.4g}, wanted at most {most:g}")

    def at_least(self, what: str, found: float, least: float) -> None:
        """Note a figure that is smaller than wanted."""
        if not found >= least:
            self.misses.append(f"{what} is {found:.4g}, wanted at least {least:g}")

    def that(self, what: str, holds: bool) -> None:
        """Note what does not hold."""
        if not holds:
            self.misses.append(what)
