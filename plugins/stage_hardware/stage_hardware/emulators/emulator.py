"""What all emulators of controllers have in common: a wire, from start to end."""

import sys
from abc import ABC, abstractmethod
from collections.abc import Iterable
from typing import Self

from stage_hardware.emulators.faults import WireFaults
from stage_hardware.emulators.wire import PseudoTerminal, TcpPort, Wire


class Emulator(ABC):
    """A controller on a wire, from ``with`` to its end; clients open ``url``.

    Faults of the wire are set on ``faults``; those of the controller are its own.
    """

    def __init__(self, wire: type[Wire] | None, *, baud: int, processing_s: float) -> None:
        """Prepare the wire, by default a pseudo-terminal where there are any; ``baud`` 0 makes bytes take no time."""
        kind = wire or (TcpPort if sys.platform == "win32" else PseudoTerminal)
        self.wire = kind(self.answer, baud=baud, processing_s=processing_s)
        self.wire.later = self.later

    @property
    def url(self) -> str:
        """What a client opens."""
        return self.wire.url

    @property
    def faults(self) -> WireFaults:
        """What is wrong with the wire."""
        return self.wire.faults

    def start(self) -> Self:
        """Begin to answer."""
        self.wire.start()
        return self

    def close(self) -> None:
        """End; safe to call twice."""
        self.wire.close()

    def __enter__(self) -> Self:
        """Start."""
        return self.start()

    def __exit__(self, *_: object) -> None:
        """Close."""
        self.close()

    @abstractmethod
    def answer(self, data: bytes) -> Iterable[bytes]:
        """Take bytes in pieces of any size, and return the replies that are due, each with its end."""

    def later(self) -> Iterable[bytes]:
        """Return replies that have had to wait, such as for the end of a motion, and are due now."""
        return ()
