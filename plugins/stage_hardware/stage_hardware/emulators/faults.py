"""What an emulator can be told to do wrong on the wire."""

from dataclasses import dataclass


@dataclass
class Faults:
    """Faults of which some are counts: so many of the next replies have them."""

    def take(self, name: str) -> bool:
        """Return whether this reply has the fault, and count it."""
        left: int = getattr(self, name)
        if left > 0:
            setattr(self, name, left - 1)
        return left > 0


@dataclass
class WireFaults(Faults):
    """Faults of the next replies; each count says how many of them, and goes down with each.

    ``late_s`` is how late a late reply comes. ``hang_up`` closes the line at once, ``deaf`` leaves it open and hears no
    more.
    """

    no_reply: int = 0
    late_reply: int = 0
    late_s: float = 0.7
    split_reply: int = 0
    garbled_reply: int = 0
    wrong_terminator: int = 0
    hang_up: bool = False
    deaf: bool = False


@dataclass
class RdtFaults(Faults):
    """Faults of a stream of records: of the next ones, as often as a count says, or for as long as a switch is on.

    ``foreign_port`` and ``foreign_address`` send records from another port, or from 127.0.0.2, ``short`` cuts them to
    35 bytes. ``swap`` sends the next but one first. ``deaf`` ignores so many requests. ``status`` is added to the
    status word. ``frozen`` keeps ft_sequence where it is, ``silent`` sends nothing, and ``slow_page_s`` lets the
    calibration page wait for so many seconds.
    """

    drop: int = 0
    duplicate: int = 0
    swap: int = 0
    short: int = 0
    foreign_port: int = 0
    foreign_address: int = 0
    deaf: int = 0
    status: int = 0
    frozen: bool = False
    silent: bool = False
    slow_page_s: float = 0.0
