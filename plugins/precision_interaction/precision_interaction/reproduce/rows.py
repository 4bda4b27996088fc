"""The rows, in the paper's order."""

from collections.abc import Sequence

from precision_interaction.reproduce.additivity import Additivity
from precision_interaction.reproduce.assembly import Assembly
from precision_interaction.reproduce.cerebellum import Cerebellum
from precision_interaction.reproduce.codes import Codes
from precision_interaction.reproduce.contact import Contact
from precision_interaction.reproduce.firing_rates import FiringRates
from precision_interaction.reproduce.hippocampus import Fig5
from precision_interaction.reproduce.row import Row


def rows() -> Sequence[Row]:
    """Return all rows."""
    return (Codes(), Fig5(), Cerebellum(), FiringRates(), Contact(), Assembly(), Additivity())
