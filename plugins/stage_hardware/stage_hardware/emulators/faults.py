"""What an emulator can be told to do wrong on the wire."""

from dataclasses import dataclass


@dataclass
class WireFaults:
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

    def take(self, name: str) -> bool:
        """Return whether this reply has the fault, and count it."""
        left: int = getattr(self, name)
        if left > 0:
            setattr(self, name, left - 1)
        return left > 0
