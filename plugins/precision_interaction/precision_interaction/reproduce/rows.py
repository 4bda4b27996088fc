"""The rows, in the paper's order."""

from collections.abc import Sequence

from precision_interaction.reproduce.assembly import Assembly
from precision_interaction.reproduce.cerebellum import Cerebellum
from precision_interaction.reproduce.row import Row


def rows() -> Sequence[Row]:
    """Return all rows."""
    return (Cerebellum(), Assembly())
