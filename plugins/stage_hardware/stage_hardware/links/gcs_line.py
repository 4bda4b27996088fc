"""A way to a controller that speaks PI's General Command Set 2.0: questions, orders with their error code, and a stop.

Source: PI, user manuals MS249E (C-863.12) and MS173E (C-863).
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence

from stage_hardware.links.serial_link import SerialLink

STOP_ALL = "\x18"
"""Stops all axes at once, wherever it stands among other bytes; it has no end and no reply."""


class GcsLine(ABC):
    """One line to one controller; :meth:`stop_all` is for any thread, the rest for one at a time.

    All methods raise a :class:`stage_hardware.errors.HardwareError`.
    """

    @property
    @abstractmethod
    def stops(self) -> int:
        """How many stops there were."""

    @abstractmethod
    def open(self) -> None:
        """Open it."""

    @abstractmethod
    def close(self) -> None:
        """Close it; safe to call at any time, and twice."""

    @abstractmethod
    def ask(self, query: str) -> list[str]:
        """Return the lines that answer a query, bare of blanks and ends; a query may be one control character."""

    def ask_all(self, queries: Sequence[str]) -> list[list[str]]:
        """Return the lines that answer each of several queries."""
        return [self.ask(query) for query in queries]

    @abstractmethod
    def order(self, command: str, stops: int) -> str:
        """Give an order, unless there were more than so many stops, and return what ``ERR?`` gives after it."""

    @abstractmethod
    def stop_all(self) -> None:
        """Stop all axes."""

    @abstractmethod
    def distrust(self) -> None:
        """Take nothing that still comes for the answer to the next query: the last one made no sense."""


class SerialGcsLine(GcsLine):
    """A serial port, or a TCP connection such as ``socket://192.168.0.1:50000``; no daisy chain."""

    def __init__(self, device: str, url: str, *, baud: int, timeout_s: float) -> None:
        """Name it; :meth:`open` opens it."""
        self._link = SerialLink(device, url, baud=baud, ends=b"\n", reply_ends=b"\n", timeout_s=timeout_s)

    @property
    def stops(self) -> int:
        """How many stops there were."""
        return self._link.stops

    def open(self) -> None:
        """Open it."""
        self._link.open()

    def close(self) -> None:
        """Close it."""
        self._link.close()

    def ask(self, query: str) -> list[str]:
        """Return the lines of an answer: all but its last end with a blank."""
        return self.ask_all([query])[0]

    def ask_all(self, queries: Sequence[str]) -> list[list[str]]:
        """Write all queries at once: a line waits for nothing but its bytes then."""
        answers = self._link.ask_all(b"".join(map(_ended, queries)), len(queries), goes_on=_goes_on)
        return [[line.strip() for line in answer] for answer in answers]

    def order(self, command: str, stops: int) -> str:
        """Write order and ``ERR?`` at once: an order has no answer of its own."""
        return self._link.ask(f"{command}\nERR?", stops=stops)

    def stop_all(self) -> None:
        """Write the one byte that stops, past whatever waits for an answer."""
        self._link.urgent(STOP_ALL.encode("ascii"), is_answered=False)

    def distrust(self) -> None:
        """Let the next query wait for what still comes."""
        self._link.distrust()


def _ended(query: str) -> bytes:
    """A control character has no end."""
    return query.encode("ascii") + (b"" if query < " " else b"\n")


def _goes_on(line: str) -> bool:
    """All lines of an answer but its last end with a blank."""
    return line.endswith(" ")
