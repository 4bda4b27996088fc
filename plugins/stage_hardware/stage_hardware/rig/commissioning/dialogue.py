"""What commissioning says to a person and asks of one."""

from collections.abc import Callable
from dataclasses import dataclass

from neurorobo.errors import NeuroroboError


class DeclinedError(NeuroroboError):
    """A person did not agree; nothing has moved since the question."""


@dataclass(frozen=True)
class Dialogue:
    """``say`` prints a line, ``agrees`` asks before motion, ``answer`` reads a line, of which an empty one ends."""

    say: Callable[[str], None]
    agrees: Callable[[str], bool]
    answer: Callable[[str], str]

    def require(self, question: str) -> None:
        """Ask, and raise a DeclinedError unless a person agrees."""
        if not self.agrees(question):
            raise DeclinedError("nothing was moved since the question; the same command goes on from here")
