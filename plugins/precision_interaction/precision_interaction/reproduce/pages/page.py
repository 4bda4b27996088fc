"""The page of a row: how its results are shown."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from precision_interaction.reproduce.row import Result, Row, Setting

if TYPE_CHECKING:
    from matplotlib.figure import Figure


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
class Page:
    """A row, its title, what it is in the paper, how long it takes on two cores, and what shows its results.

    ``minutes`` are those of the published results, two cells at a time. ``present`` is given the results of all cells,
    by name. ``package`` is what its row imports beyond the plugin's dependencies; the plugin has an extra of that name.
    """

    row: Row
    title: str
    paper: str
    minutes: float
    present: Callable[[Mapping[str, Result], Setting], Presentation]
    package: str | None = None


def duration(seconds: float) -> str:
    """Return a time in minutes, or in seconds where minutes would say little: `15.4 minutes`, `2 seconds`."""
    if seconds >= 60:
        return f"{seconds / 60:.1f} minutes"
    whole = max(1, round(seconds))
    return f"{whole} second{'s' if whole > 1 else ''}"


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
