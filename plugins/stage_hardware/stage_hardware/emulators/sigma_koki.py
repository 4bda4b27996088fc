"""What the emulators of SIGMA KOKI's controllers have in common: lines in, lines out, and axes that count pulses."""

import threading
from abc import abstractmethod
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from stage_hardware.emulators.emulator import Emulator
from stage_hardware.emulators.mechanism import Mechanism
from stage_hardware.emulators.wire import Wire

DIVISIONS = (1, 2, 4, 5, 8, 10, 20, 25, 40, 50, 80, 100, 125, 200, 250)
"""Micro-steps per full step that a driver can be set to."""


class Speeds(NamedTuple):
    """A start speed and a largest one in pulses per second, and the time from one to the other in ms."""

    start: int
    fast: int
    ramp_ms: int


POWER_ON_SPEEDS = Speeds(500, 5000, 200)


class SigmaKokiEmulator(Emulator):
    """A controller on a wire, from ``with`` to its end; clients open ``url``.

    ``axes`` are its mechanisms, in pulses. Faults: those of the wire in ``faults``; ``refusals``, how many of the next
    commands are refused; :meth:`power_cycle`, :meth:`free_motor`, and what a mechanism can do by itself (switches
    where none should be, slowness). ``heard`` keeps all lines that arrived.
    """

    def __init__(
        self,
        positions: Sequence[int],
        *,
        travel: tuple[int, int],
        wire: type[Wire] | None,
        baud: int,
        processing_s: float,
    ) -> None:
        """Put each axis at a position within its travel; ``baud`` 0 makes bytes take no time."""
        super().__init__(wire, baud=baud, processing_s=processing_s)
        self.axes = [
            Mechanism(*travel, position=position, start_speed=0, speed=1, acceleration=1) for position in positions
        ]
        self.refusals, self.heard, self.origin_speeds = 0, list[str](), POWER_ON_SPEEDS
        self._lock, self._rest = threading.RLock(), b""
        self._forget()

    def power_cycle(self) -> None:
        """Switch it off and on: motions end, and positions and settings are lost."""
        with self._lock:
            for axis in self.axes:
                axis.power_cycle()
            self._forget()

    def free_motor(self, index: int) -> None:
        """Take the current from a motor: its motion ends."""
        with self._lock:
            self.axes[index].stop(hard=True)
            self.axes[index].motor_on = False

    def _forget(self) -> None:
        """Set to what holds when it is switched on."""
        self.speeds, self.divisions = [POWER_ON_SPEEDS] * len(self.axes), [2] * len(self.axes)

    def answer(self, data: bytes) -> Iterator[bytes]:
        """Answer whole lines."""
        *lines, self._rest = (self._rest + data).split(b"\r\n")
        for line in lines:
            command = line.decode("ascii", errors="replace").strip()
            with self._lock:
                self.heard.append(command)
                reply = self._reply(command)
            if reply is not None:
                yield reply.encode("ascii") + b"\r\n"

    @abstractmethod
    def _reply(self, command: str) -> str | None:
        """Carry out a command, and return what answers it, if anything does."""

    def _takes_refusal(self) -> bool:
        if self.refusals <= 0:
            return False
        self.refusals -= 1
        return True

    def _counts(self) -> list[int]:
        return [round(axis.counter) for axis in self.axes]

    def _ready(self, index: int, speeds: Speeds) -> Mechanism:
        """Return an axis that is set to speeds."""
        axis = self.axes[index]
        axis.start_speed, axis.speed = speeds.start, speeds.fast
        ramp_s = max(speeds.ramp_ms, 1e-3) / 1e3
        axis.acceleration = max(1.0, (speeds.fast - speeds.start) / ramp_s)
        return axis

    def _move(self, index: int, target: int) -> None:
        self._ready(index, self.speeds[index]).move_to(target)

    def _jog(self, index: int, direction: int) -> None:
        start = self.speeds[index].start
        self._ready(index, Speeds(start, start, 0)).jog(direction)

    def _home(self, index: int) -> None:
        self._ready(index, self.origin_speeds).home()
