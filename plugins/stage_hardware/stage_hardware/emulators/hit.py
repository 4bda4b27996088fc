"""Emulates controllers in HIT mode: HSC-103, HIT-M and SHRC-203.

From what manufacturer and independent drivers publish; not compared with a device. Uncertain: which conditions are
refused (here: a command to an axis that moves, or whose motor is off), the motor command `C:` in this mode, and how a
contact with a limit switch is told (here: not at all; the axis just stops).
"""

import re
from collections.abc import Callable, Sequence

from stage_hardware.emulators.sigma_koki import DIVISIONS, SigmaKokiEmulator, Speeds
from stage_hardware.emulators.wire import Wire

AXES = {"HSC-103": 3, "HIT-M": 8, "SHRC-203": 3}
FASTEST_PPS = 4_000_000


class HitEmulator(SigmaKokiEmulator):
    """A controller in HIT mode; an SHRC-203 speaks another format (``SHOT`` here) until it is told `FMT:HIT`."""

    def __init__(
        self,
        model: str = "HSC-103",
        *,
        positions: Sequence[int] | None = None,
        travel: tuple[int, int] = (-1_000_000, 1_000_000),
        wire: type[Wire] | None = None,
        baud: int = 38400,
        processing_s: float = 0.002,
    ) -> None:
        """Put each axis at a position, or at 200 pulses."""
        self.model = model
        super().__init__(
            positions or [200] * AXES[model], travel=travel, wire=wire, baud=baud, processing_s=processing_s
        )

    def _forget(self) -> None:
        super()._forget()
        self._format = "SHOT" if self.model == "SHRC-203" else "HIT"

    def _reply(self, command: str) -> str:
        if self.model == "SHRC-203":
            if command == "?:FMT":
                return self._format
            if command in ("FMT:HIT", "FMT:SHOT"):
                self._format = command[4:]
                return "OK"
        if command == "?:N":
            return self.model
        if self._format != "HIT":
            return "NG"
        if command == "Q:":
            return ",".join(map(str, self._counts()))
        if command == "!:":
            return ",".join("1" if axis.moving else "0" for axis in self.axes)
        if command == "?:V":
            return "V1.00"
        return "OK" if not self._takes_refusal() and self._carries_out(command) else "NG"

    def _carries_out(self, command: str) -> bool:
        """Do it, or return False."""
        head, _, rest = command.partition(":")
        fields = {index: field for index, field in enumerate(rest.split(",")) if field}
        if command == "L:E":
            for axis in self.axes:
                axis.stop(hard=True)
            return True
        if head == "D":
            return self._sets_speeds(rest)
        if not fields or max(fields) >= len(self.axes):
            return False
        if head == "L":
            return self._each(fields, r"[01]", lambda index, on: self.axes[index].stop(hard=False) if on else None)
        if any(self.axes[index].moving for index in fields):
            return False
        if head == "C":
            return self._each(fields, r"[01]", lambda index, on: setattr(self.axes[index], "motor_on", bool(on)))
        if head == "R":
            return self._each(fields, r"[01]", lambda index, on: self.axes[index].set_counter(0) if on else None)
        if head == "S" and self.model == "SHRC-203":
            if not all(field.isdigit() and int(field) in DIVISIONS for field in fields.values()):
                return False
            return self._each(fields, r"\d+", self.divisions.__setitem__)
        if not all(self.axes[index].motor_on for index in fields):
            return False
        if head == "H":
            return self._each(fields, r"[01]", lambda index, on: self._home(index) if on else None)
        if head == "J":
            return self._each(fields, r"[+-]", lambda index, sign: self._jog(index, sign))
        if head in ("A", "M"):
            counts = self._counts() if head == "M" else [0] * len(self.axes)
            if any(re.fullmatch(r"[+-]?\d{1,9}", field) is None for field in fields.values()):
                return False
            return self._each(fields, r"[+-]?\d+", lambda index, value: self._move(index, counts[index] + value))
        return False

    def _sets_speeds(self, rest: str) -> bool:
        numbers = rest.split(",")
        if len(numbers) != 4 or not all(number.isdigit() for number in numbers):
            return False
        number, *three = map(int, numbers)
        speeds = Speeds(*three)
        if not (1 <= number <= len(self.axes) and 1 <= speeds.start <= speeds.fast <= FASTEST_PPS):
            return False
        if self.axes[number - 1].moving or speeds.ramp_ms > 1000:
            return False
        self.speeds[number - 1] = speeds
        return True

    @staticmethod
    def _each(fields: dict[int, str], pattern: str, do: Callable[[int, int], object]) -> bool:
        """Do something with each field that is there, or nothing and return False if one makes no sense."""
        if any(re.fullmatch(pattern, field) is None for field in fields.values()):
            return False
        for index, field in fields.items():
            do(index, int(field + "1" if field in "+-" else field))
        return True
