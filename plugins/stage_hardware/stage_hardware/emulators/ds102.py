"""Emulates Suruga Seiki's DS102 and DS112, also sold as MISUMI DS102MS.

From what the manufacturer's samples and independent drivers publish; not compared with a device. Uncertain, and chosen
here: when E-codes come (a switch), that the rest of a refused line is dropped, that queries joined by `:` are answered
by a line each, that settings cannot be written on the way, that `STOP` stops all axes whatever is selected and waits
for the end of a `DW`, that axis 1 is selected at first, what speeds a new controller has, which limit edge origin types
5 and 6 look for (5 the counterclockwise one), that `*RST` is deaf for its 5 s and ends as a power cycle does, and the
format of positions in units other than pulses. An origin is run to in a straight line, S-curves are trapezoids, and the
memory switches 1 to 6 are kept and do nothing. Not there: interpolation (`GOLI`, `GOLA`), teaching, programs; they are
refused. Long forms of keywords are known of two, `AXIs` and `PULSe`.
"""

import re
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from enum import StrEnum

from stage_hardware.emulators.ds102_axis import (
    DRIVES,
    EMERGENCY,
    IN_MOTION,
    NOT_CONNECTED,
    SETTINGS,
    DS102Axis,
    RefusalError,
)
from stage_hardware.emulators.emulator import Emulator
from stage_hardware.emulators.mechanism import Mechanism
from stage_hardware.emulators.wire import Wire

COMMAND_RULE, NO_DELIMITER, OUT_OF_RANGE = "E20", "E21", "E22"

LONGEST_LINE = 100
"""Characters; from one client that keeps below it."""

WRITE_S = 0.13

LETTERS = "XYZUVW"

SYSTEM_COMMANDS = ("STOP", "DW", "WRITE", "*RST")
KEYWORDS = (*SETTINGS, *SYSTEM_COMMANDS, "POS", "GO", "GOABS")


class ErrorReports(StrEnum):
    """When the E-code of a set command is told: at once, in place of the next reply, or never.

    Queries that are wrong are answered by their E-code in any case.
    """

    AT_ONCE = "at once"
    NEXT_QUERY = "with the next query"
    NEVER = "never"


class DS102Emulator(Emulator):
    """A controller on a wire, from ``with`` to its end; clients open ``url``.

    ``axes`` are its mechanisms, in full steps: with the division of 1 that a new one has, these are pulses.
    ``controls`` are what it makes of them. Connectors that have no axis read as not connected. Faults: those of the
    wire in ``faults``; ``refusals``, the E-codes of the next set commands; ``emergency``, the input for that;
    ``guesses``, with which queries that it does not know are answered by 0 rather than E20, as was seen on a device;
    :meth:`unplug`, :meth:`power_cycle`, and what a mechanism can do by itself (switches where none should be,
    slowness). ``heard`` keeps all lines that arrived.
    """

    def __init__(
        self,
        positions: Sequence[float] = (200, 200),
        *,
        travel: tuple[float, float] = (-20_000, 20_000),
        connectors: int = 2,
        model: str = "DS102",
        errors_come: ErrorReports = ErrorReports.AT_ONCE,
        has_micro_steps: bool = True,
        origin_type: int = 0,
        residue: int = 3,
        wire: type[Wire] | None = None,
        baud: int = 38400,
        processing_s: float = 0.05,
        reset_s: float = 5.0,
    ) -> None:
        """Put each axis at a position within its travel.

        ``origin_type`` is the `MEMSW0` that was written before, 0 looking for no origin, and ``residue`` the count at
        an origin that was found. ``baud`` 0 makes bytes take no time; ``processing_s`` passes before each reply, on a
        device behind Windows and USB some 50 ms.
        """
        if connectors not in (2, 4, 6) or not 0 < len(positions) <= connectors:
            raise ValueError(
                f"it has 2, 4 or 6 connectors and as many axes at most, got {connectors}, {len(positions)}"
            )
        super().__init__(wire, baud=baud, processing_s=processing_s)
        self.model, self.connectors, self.errors_come, self.reset_s = model, connectors, errors_come, reset_s
        self.axes = [
            Mechanism(*travel, position=position, start_speed=1, speed=1, acceleration=1) for position in positions
        ]
        self.controls = [
            DS102Axis(axis, has_micro_steps=has_micro_steps, origin_type=origin_type, residue=residue)
            for axis in self.axes
        ]
        self.refusals, self.heard = list[str](), list[str]()
        self.emergency = self.guesses = False
        self._lock, self._deaf_until_s = threading.RLock(), 0.0
        self._forget()

    def power_cycle(self) -> None:
        """Switch it off and on: motions end, and positions and settings that were not written are lost."""
        with self._lock:
            for control in self.controls:
                control.mechanism.power_cycle()
                control.switch_on()
            self._forget()

    def unplug(self, index: int) -> None:
        """Pull the cable of an axis: it stands still."""
        with self._lock:
            self.controls[index].stop(hard=True)
            self.controls[index].connected = False

    def press_emergency_stop(self) -> None:
        """Close the input for emergencies, until ``emergency`` is False again: all axes stop, and none begins."""
        with self._lock:
            self.emergency = True
            self._stop_all(hard=True)

    def _forget(self) -> None:
        """Set to what holds when it is switched on."""
        self._selected: list[int] = [0]
        self._lines: deque[deque[str]] = deque()  # sub-commands that are to be carried out
        self._rest, self._busy_until_s, self._waits_for_drive = b"", 0.0, False
        self._untold: str | None = None

    def answer(self, data: bytes) -> Iterator[bytes]:
        """Take whole lines, and carry them out."""
        with self._lock:
            if time.monotonic() < self._deaf_until_s:
                return
            *lines, self._rest = (self._rest + data).split(b"\r")
            for line in lines:
                text = line.decode("ascii", errors="replace")
                self.heard.append(text)
                self._lines.append(deque([text] if len(text) > LONGEST_LINE else text.split(":") if text else []))
        yield from self.later()

    def later(self) -> Iterator[bytes]:
        """Carry out what has come, as far as nothing holds it up."""
        while True:
            with self._lock:
                if not self._lines or self._is_held_up():
                    return
                if not self._lines[0]:
                    self._lines.popleft()
                    continue
                reply = self._reply(self._lines[0].popleft())
            if reply is not None:
                yield reply.encode("ascii") + b"\r"

    def _is_held_up(self) -> bool:
        self._waits_for_drive = self._waits_for_drive and any(control.moving for control in self.controls)
        return self._waits_for_drive or time.monotonic() < self._busy_until_s

    def _reply(self, command: str) -> str | None:
        """Carry out a sub-command, and return what answers it, if anything does."""
        command = command.strip(" ").upper()
        is_query = command.endswith("?")
        try:
            if is_query:
                told, self._untold = self._untold, None
                return told or self._told(command[:-1])
            self._carry_out(command)
        except RefusalError as refusal:
            if self._lines:
                self._lines[0].clear()
            if is_query or self.errors_come is ErrorReports.AT_ONCE:
                return refusal.code
            if self.errors_come is ErrorReports.NEXT_QUERY:
                self._untold = self._untold or refusal.code
        return None

    def _carry_out(self, command: str) -> None:
        if len(command) > LONGEST_LINE:
            raise RefusalError(COMMAND_RULE)
        if (selector := re.fullmatch(r"AXIS?(\w+)", command)) is not None:
            self._select(selector[1])
            return
        word, _, argument = command.partition(" ")
        word, argument = _short(word), argument.strip(" ")
        if word not in KEYWORDS:
            is_glued = any(re.fullmatch(rf"{re.escape(known)}[-+\d.]+", word) for known in (*KEYWORDS, "PULSE"))
            raise RefusalError(NO_DELIMITER if is_glued else COMMAND_RULE)
        if self.refusals:
            raise RefusalError(self.refusals.pop(0))
        if word in SYSTEM_COMMANDS:
            self._carry_out_for_all(word, argument)
            return
        axes = [self._axis(index) for index in self._selected]
        if word == "GO":
            self._go(axes, DRIVES[int(argument)] if re.fullmatch("[0-6]", argument) else argument)
        elif word == "GOABS":
            self._set(axes, "PULSA", argument)
            self._go(axes, "ABS")
        else:
            self._set(axes, word, argument)

    def _select(self, which: str) -> None:
        if which == "ALL":
            self._selected = list(range(len(self.axes)))
        elif re.fullmatch("[1-6XYZUVW]", which):
            self._selected = [LETTERS.index(which) if which in LETTERS else int(which) - 1]
        else:
            raise RefusalError(OUT_OF_RANGE)

    def _axis(self, index: int) -> DS102Axis:
        if index >= len(self.controls):
            raise RefusalError(NOT_CONNECTED)
        return self.controls[index]

    def _carry_out_for_all(self, word: str, argument: str) -> None:
        if word == "STOP":
            if argument not in ("0", "1"):
                raise RefusalError(OUT_OF_RANGE)
            self._stop_all(hard=argument == "0")
            return
        if argument:
            raise RefusalError(COMMAND_RULE)
        if word == "DW":
            self._waits_for_drive = True
        elif word == "WRITE":
            self._busy_until_s = time.monotonic() + WRITE_S
            for control in self.controls:
                control.flash = dict(control.settings)
        else:
            self._deaf_until_s = time.monotonic() + self.reset_s
            self.power_cycle()

    def _stop_all(self, *, hard: bool) -> None:
        for control in self.controls:
            control.stop(hard=hard)

    def _go(self, axes: Iterable[DS102Axis], drive: str) -> None:
        if drive not in DRIVES:
            raise RefusalError(OUT_OF_RANGE if drive.isdigit() else COMMAND_RULE)
        if self.emergency:
            raise RefusalError(EMERGENCY)
        for axis in axes:
            axis.go(drive)

    def _set(self, axes: Iterable[DS102Axis], name: str, argument: str) -> None:
        if re.fullmatch(r"[-+]?(\d+\.?\d*|\.\d+)", argument) is None:
            raise RefusalError(COMMAND_RULE)
        value = float(argument)
        setting = SETTINGS["PULSA" if name == "POS" else name]
        for axis in axes:
            if not setting.lo <= value <= setting.hi or (name == "DRDIV" and value and not axis.has_micro_steps):
                raise RefusalError(OUT_OF_RANGE)
            if axis.moving:
                raise RefusalError(IN_MOTION)
            is_whole = not setting.is_fraction and not (setting.is_distance and axis.settings["UNIT"])
            if is_whole and "." in argument:
                return  # without a word, as was seen on a device
            if name == "POS":
                axis.set_count(round(value / axis.resolution))
            else:
                axis.write(name, value)

    def _told(self, asked: str) -> str:
        """Return the answer to a query."""
        for_all: dict[str, Callable[[], str]] = {
            "*IDN": lambda: f"SURUGA,{self.model},0,VER4.00",
            "DS102VER": lambda: f"{self.model} 4.00",
            "CONTA": lambda: str(self.connectors),
            "MOTIONA": lambda: str(sum(1 << index for index, axis in enumerate(self.controls) if axis.moving)),
            "EMS": lambda: str(int(self.emergency)),
        }
        if asked in for_all:
            return for_all[asked]()
        asked = _short(asked)
        if len(self._selected) != 1:
            raise RefusalError(COMMAND_RULE)
        index = self._selected[0]
        if asked == "SB3" and index >= self.connectors:
            return "0"
        if asked == "SB3":
            return str(1 + 2 * self.controls[0].has_micro_steps)
        if asked == "SB2" and len(self.controls) <= index < self.connectors:
            return "3"
        axis = self._axis(index)
        if asked in SETTINGS:
            return _written(axis.settings[asked])
        for_one: dict[str, Callable[[], float]] = {
            "POS": lambda: axis.count * axis.resolution,
            "SB1": axis.sb1,
            "SB2": axis.sb2,
            "MOTION": lambda: axis.moving,
            "READY": lambda: not axis.moving and axis.connected and not self.emergency,
            "ORG": lambda: axis.origin_found,
            "HOME": lambda: axis.at_home,
            "RESOLUT": lambda: axis.settings["STANDARD"] / axis.division,
        }
        if asked in for_one:
            return _written(for_one[asked]())
        if self.guesses:
            return "0"
        raise RefusalError(COMMAND_RULE)


def _short(word: str) -> str:
    return "PULS" if word == "PULSE" else word


def _written(value: float) -> str:
    """Return a number without a fraction if it has none."""
    text = f"{value:.6f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text
