"""A row of the reproduction: what is measured."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

Result = Mapping[str, Any]
"""What a cell measured; it must survive JSON."""


@dataclass(frozen=True)
class Setting:
    """What every cell is told: the folder of the examples, and whether to try things out on a small scale."""

    examples: Path
    quick: bool = False


class Row(ABC):
    """One figure or table of the paper, or one claim beyond it.

    Its ``cells`` are measured one by one, in any order and in processes of their own with one thread each, and are kept
    one by one, until the module of the row or one that it imports changes. How it is shown is another module's business
    (:class:`precision_interaction.reproduce.pages.page.Page`).

    ``bystanders`` are modules that are named on the way but take no part: they do not count, nor what they alone need.
    """

    name: ClassVar[str]
    bystanders: ClassVar[frozenset[str]] = frozenset()

    @abstractmethod
    def cells(self, setting: Setting) -> Sequence[str]:
        """Return the names of the cells."""

    @abstractmethod
    def measure(self, cell: str, setting: Setting) -> Result:
        """Measure one cell; deterministic."""

    def files(self, setting: Setting) -> Sequence[Path]:
        """Return the files that the results depend on besides the code, such as examples and weights."""
        return ()

    def words(self, setting: Setting) -> Sequence[str]:
        """Return what else the results depend on, such as a part of a file."""
        return ()
