"""Stages behind a DS102 or DS112 of Suruga Seiki (sold as DS102MS by MISUMI too).

Written from what is published of the manual and of programs for it, and tried on no device. Accepted commands have no
reply: whether they were carried out is asked. Not verified: when error codes are sent, so they are looked for in
whatever comes; that clockwise (CW) is where positions grow; that ``CCWSLP?`` and ``MEMSW0?`` answer as ``CWSLP?`` does;
that the acceleration time is that from rest to the drive speed. Settings are lost with the power, the soft limits too,
by which a power cycle is noticed, unless somebody has saved in the controller that they are on.

Source: Suruga Seiki, DS102/DS112 operation manual 2.00; MISUMI, DS102MS manual, pages 133 and 150.
"""

import math
import re
import threading
import time
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from fractions import Fraction

from stage_hardware.errors import HardwareError, RefusedError, ReplyError, ReplyTimeoutError
from stage_hardware.links.serial_link import SerialLink
from stage_hardware.stage import Axis, AxisState, Stage, StageState

ERROR_CODE = re.compile(r"E\d\d")
ERRORS = {
    "E00": ("no stage is connected, or the logic of its sensors is wrong", "see to its cable"),
    "E01": ("the axis is in motion", "wait until it stands, or stop it"),
    "E02": ("the axis is at a limit", "find out why, then home it"),
    "E03": ("there is an emergency stop", "release it when it is safe to, then home the axes"),
    "E20": ("a command breaks the rules", "see whether this controller knows it"),
    "E21": ("a delimiter is missing", "see whether this controller knows the command"),
    "E22": ("a value is out of range", "see what the controller allows"),
    "E40": ("the line is disturbed", "see to baud rate and cable"),
    "E41": ("its flash memory cannot be written", "have it repaired"),
}

CUT_SHORT, ORIGIN_FOUND, MOVING = 0x08, 0x10, 0x40
"""Bits of the status byte 1."""

UPPER_SWITCH, LOWER_SWITCH, BOTH_SWITCHES = 0x01, 0x02, 0x03
UPPER_SOFT, LOWER_SOFT, SOFT_LIMITS_ON = 0x04, 0x08, 0x30
"""Bits of the status byte 2; both switches at once stand for a stage that is not there."""

AVAILABLE = 0x01
"""A bit of the status byte 3."""

LEFT_AT_ORIGIN = 8
"""Pulses that the counter was seen to show after an origin was found."""

LARGEST_POSITION, LARGEST_SPEED, LARGEST_START_SPEED, LONGEST_RAMP_MS = 99_999_999, 999_999, 9_999, 9_999


@dataclass(frozen=True)
class DS102Axis:
    """One axis of a controller: what it can do, its number from 1 on, and how many pulses make one of its units.

    ``origin_type`` is the controller's way to find the origin, MEMSW0: 1 and 2 by edges of the near-origin and the
    origin sensor, 3 and 4 by an edge of the origin sensor, 5 and 6 by an edge of a limit switch, 7 to 12 the same and
    then the timing signal. ``drive_division`` is the index of the micro-step division, DRDIV; None leaves it.
    """

    axis: Axis
    number: int
    pulses_per_unit: Fraction | int
    origin_type: int
    start_speed_pulses_per_s: int = 100
    s_curve_percent: int = 0
    drive_division: int | None = None

    def __post_init__(self) -> None:
        """Refuse what the controller cannot be set to."""
        for what, value, lo, hi in (
            ("number", self.number, 1, 6),
            ("origin type", self.origin_type, 1, 12),
            ("lower limit", self.pulses(self.axis.lo), -LARGEST_POSITION, LARGEST_POSITION),
            ("upper limit", self.pulses(self.axis.hi), -LARGEST_POSITION, LARGEST_POSITION),
            ("speed in pulses per second", self.speed_pulses_per_s, 1, LARGEST_SPEED),
            ("start speed in pulses per second", self.start_speed_pulses_per_s, 1, LARGEST_START_SPEED),
            ("time to the speed in ms", self.ramp_ms, 1, LONGEST_RAMP_MS),
            ("S-curve in percent", self.s_curve_percent, 0, 100),
            ("drive division", self.drive_division or 0, 0, 15),
        ):
            if not lo <= value <= hi:
                raise ValueError(f"the {what} of an axis of a DS102 is within {lo}..{hi}, got {value}")
        if not math.isclose(self.axis.resolution * self.pulses_per_unit, 1, rel_tol=1e-6):
            raise ValueError(
                f"the resolution of the axis is {self.axis.resolution:g} {self.axis.unit}, "
                f"a pulse is {float(1 / Fraction(self.pulses_per_unit)):g}"
            )

    @property
    def speed_pulses_per_s(self) -> int:
        """The drive speed that the axis can take."""
        return math.floor(Fraction(self.axis.speed) * self.pulses_per_unit)

    @property
    def ramp_ms(self) -> int:
        """How long speeding up has to take so that the acceleration is one that the axis can take."""
        return math.ceil(self.speed_pulses_per_s * 1000 / (Fraction(self.axis.acceleration) * self.pulses_per_unit))

    def pulses(self, position: float) -> int:
        """Return the pulse that is nearest to a position."""
        return round(Fraction(position) * self.pulses_per_unit)

    def position(self, pulses: int) -> float:
        """Return the position of a pulse."""
        return float(pulses / Fraction(self.pulses_per_unit))

    def settings(self) -> dict[str, int]:
        """Return what a power cycle loses and is asked for by the same word, in the order in which it is set."""
        settings = {"UNIT": 0, "SELSP": 0}
        if self.drive_division is not None:
            settings["DRDIV"] = self.drive_division
        return settings | {
            "L0": min(self.start_speed_pulses_per_s, self.speed_pulses_per_s),
            "R0": self.ramp_ms,
            "S0": self.s_curve_percent,
            "F0": self.speed_pulses_per_s,
            "MEMSW0": self.origin_type,
            "CWSLP": self.pulses(self.axis.hi),
            "CCWSLP": self.pulses(self.axis.lo),
        }


class DS102Stage(Stage):
    """A controller at a serial port.

    Soft limits count from the origin: they are off while it is looked for. An axis that was homed is at 0 there.
    Axes begin one after the other; if one is refused, all are stopped. An axis that moves takes no other target.
    """

    def __init__(
        self,
        name: str,
        url: str,
        axes: Mapping[str, DS102Axis],
        *,
        baud: int = 38400,
        timeout_s: float = 0.5,
        begins_within_s: float = 0.5,
    ) -> None:
        """Remember what is known before connecting; motions that are not seen to begin in time were refused."""
        super().__init__(name, {axis_name: axis.axis for axis_name, axis in axes.items()})
        self._axes, self._begins_within_s = dict(axes), begins_within_s
        self._link = SerialLink(
            name,
            url,
            baud=baud,
            ends=b"\r",
            reply_ends=b"\r",
            timeout_s=timeout_s,
            unasked=self._look_for_codes,
            knows_replies=True,  # see _get_in_step
        )
        self._lock = threading.RLock()
        self._forget()

    def connect(self) -> None:
        """Open the line, stop what another program may have left moving, and set up all axes."""
        with self._lock:
            self._link.close()
            self._link.open()
            self._forget()
            try:
                self._set_up_all(self._link.stops)
            except HardwareError:
                self._link.close()
                raise

    def close(self) -> None:
        """Close the line."""
        self._link.close()

    def home(self, axes: Collection[str]) -> None:
        """Begin to look for the origins; :meth:`state` sets the counter of an axis to 0 when it has found its own.

        Settings are written anew, as a power cycle may have lost them.
        """
        stops = self._link.stops
        chosen = {name: self._axis(name) for name in axes}
        with self._lock:
            self._codes.clear()
            for name, axis in chosen.items():
                self._see_standing(name, axis, stops)
                self._referenced.discard(name)
                self._failed.pop(name, None)
                self._targets.pop(name, None)
                self._set_up(axis, stops)
                self._switch_limits(name, axis, stops, on=False)
            self._was_off = False
            self._begin({name: (axis, "GO ORG", None) for name, axis in chosen.items()}, stops)

    def move_to(self, targets: Mapping[str, float]) -> None:
        """Begin to move, and see that the axes do."""
        stops = self._link.stops
        moves = {}
        for name, target in targets.items():
            axis = self._axis(name)
            if not axis.axis.lo <= target <= axis.axis.hi:
                raise HardwareError(
                    self.name,
                    f"{name} cannot go to {target:g} {axis.axis.unit}, "
                    f"its limits are {axis.axis.lo:g}..{axis.axis.hi:g}",
                    "stay within them",
                )
            pulses = axis.pulses(target)
            moves[name] = axis, f"GOABS {pulses}", pulses
        with self._lock:
            self._codes.clear()
            for name, (axis, _, _) in moves.items():
                self._see_standing(name, axis, stops)
                self._see_power(name, self._status(axis, 2, stops))
                if name not in self._referenced:
                    raise HardwareError(self.name, f"{name} is not referenced", "home it first")
            self._begin(moves, stops)

    def stop(self) -> None:
        """Stop all axes without ramps, past whatever is under way."""
        self._link.urgent(b"STOP 0\r", is_answered=False)

    def state(self) -> StageState:
        """Ask for status, limits and position of each axis, in this order: one that stands has the position it keeps.

        Its time is that of the first reply. Error codes stay its fault until the next order.
        """
        with self._lock:
            axes, faults, time_ns = {}, [], 0
            for name, axis in self._axes.items():
                status = self._status(axis, 1)
                time_ns = time_ns or time.monotonic_ns()
                limits = self._status(axis, 2)
                self._see_power(name, limits)
                moving = bool(status & MOVING)
                if not moving:
                    self._maybe_moving.discard(name)
                    self._see_origin(name, axis, status)
                pulses = self._number(axis, "POS")
                axes[name] = AxisState(
                    axis.position(pulses), moving, name in self._referenced, *self._limits_hit(name, limits)
                )
                faults += self._faults(name, status, limits, pulses)
            faults += [_fault_and_cure(code)[0] for code in self._codes]
            if self._was_off:
                faults.append("settings are gone, as after a power cycle; home the axes")
                axes = {
                    name: AxisState(at.position, at.moving, False, at.at_lower_limit, at.at_upper_limit)
                    for name, at in axes.items()
                }
            return StageState(time_ns, axes, "; ".join(faults) or None)

    def _forget(self) -> None:
        """Begin to know nothing of the controller."""
        self._is_in_step, self._was_off = False, False
        self._codes: dict[str, None] = {}  # a set in the order in which they came
        self._referenced: set[str] = set()
        self._limited: set[str] = set()  # where soft limits were switched on
        self._maybe_moving = set(self._axes)
        self._homing: dict[str, int] = {}  # the count of stops when it began
        self._targets: dict[str, tuple[int, int]] = {}  # in pulses, and that count
        self._failed: dict[str, str] = {}

    def _set_up_all(self, stops: int) -> None:
        identity = self._get_in_step()
        if not re.search("DS1[01]2", identity):
            raise HardwareError(self.name, f"it says that it is {identity!r}", "see which port it is on")
        self._link.send("STOP 0", stops=stops)
        there = self._integer(self._ask("CONTA?", stops), "CONTA?")
        for name, axis in self._axes.items():
            if axis.number > there or not self._status(axis, 3, stops) & AVAILABLE:
                raise HardwareError(
                    self.name, f"{name} is axis {axis.number}, which is not there", "see to its number and its cable"
                )
            deadline = time.monotonic() + self._begins_within_s
            while self._status(axis, 1, stops) & MOVING:
                if time.monotonic() > deadline:
                    raise HardwareError(self.name, f"{name} does not stop", "stop it at the controller")
            self._maybe_moving.discard(name)
            self._set_up(axis, stops)
            self._switch_limits(name, axis, stops, on=True)

    def _set_up(self, axis: DS102Axis, stops: int) -> None:
        """Write all settings and read them back."""
        settings = axis.settings()
        words = [f"{word} {value}" for word, value in settings.items()]
        words.append("MEMSW7 0")  # the counter begins at 0 where the origin is
        for first in range(0, len(words), 4):  # lines stay far below 100 characters
            self._send(axis, ":".join(words[first : first + 4]), stops)
        for word, value in settings.items():
            there = self._number(axis, word, stops)
            self._raise_codes(f"{word} of axis {axis.number}")
            if there != value:
                raise HardwareError(
                    self.name,
                    f"{word} of axis {axis.number} is {there} after it was set to {value}",
                    "see what the controller allows",
                )

    def _switch_limits(self, name: str, axis: DS102Axis, stops: int, *, on: bool) -> None:
        self._limited.discard(name)
        self._send(axis, f"CWSLE {on:d}:CCWSLE {on:d}", stops)
        if self._status(axis, 2, stops) & SOFT_LIMITS_ON != SOFT_LIMITS_ON * on:
            self._raise_codes(f"switching the soft limits of {name}")
            raise HardwareError(
                self.name, f"the soft limits of {name} do not go {'on' if on else 'off'}", "see whether it has any"
            )
        if on:
            self._limited.add(name)

    def _begin(self, motions: Mapping[str, tuple[DS102Axis, str, int | None]], stops: int) -> None:
        """Send what begins each motion, then see that each has begun; to a target, or to the origin if it is None."""
        try:
            for name, (axis, command, target) in motions.items():
                self._maybe_moving.add(name)
                if target is None:
                    self._homing[name] = stops
                else:
                    self._targets[name] = target, stops
                self._send(axis, command, stops)
            for name, (axis, _, target) in motions.items():
                self._see_begun(name, axis, target, stops)
        except RefusedError:
            self.stop()
            raise

    def _see_begun(self, name: str, axis: DS102Axis, target: int | None, stops: int) -> None:
        deadline = time.monotonic() + self._begins_within_s
        while True:
            status = self._status(axis, 1, stops)
            self._raise_codes(f"a motion of {name}")
            if status & MOVING:
                return
            pulses = self._number(axis, "POS", stops)  # of one that has ended by now
            if pulses == target:
                self._maybe_moving.discard(name)
                return
            if target is None and status & ORIGIN_FOUND and abs(pulses) <= LEFT_AT_ORIGIN:
                return  # elsewhere the bit may be that of an earlier search
            if time.monotonic() > deadline:
                why = _why_it_stands(status, self._status(axis, 2, stops))
                raise RefusedError(
                    self.name, f"{name} does not move{why}", "see to its limits, its motor and the emergency stop"
                )

    def _see_standing(self, name: str, axis: DS102Axis, stops: int) -> None:
        """Refuse an axis that moves; one that stood when it was last looked at has had no command since."""
        if name in self._maybe_moving:
            if self._status(axis, 1, stops) & MOVING:
                raise RefusedError(self.name, f"{name} is in motion", "wait until it stands, or stop it")
            self._maybe_moving.discard(name)
        self._raise_codes(f"before a motion of {name}")

    def _see_power(self, name: str, limits: int) -> None:
        """Notice that soft limits are off which were switched on: the counters are lost too."""
        if name in self._limited and limits & SOFT_LIMITS_ON != SOFT_LIMITS_ON:
            self._was_off = True
            for known in (self._referenced, self._limited, self._homing, self._targets):
                known.clear()

    def _see_origin(self, name: str, axis: DS102Axis, status: int) -> None:
        """Finish the homing of an axis that stands."""
        if name not in self._homing:
            return
        stops = self._homing.pop(name)
        if stops != self._link.stops:
            return
        if not status & ORIGIN_FOUND or status & CUT_SHORT:
            self._failed[name] = f"{name} has not found its origin"
            return
        self._send(axis, "POS 0", stops)  # a few pulses can be left
        if self._number(axis, "POS", stops) != 0:
            self._failed[name] = f"the counter of {name} does not go to 0"
            return
        self._switch_limits(name, axis, stops, on=True)
        self._referenced.add(name)

    def _limits_hit(self, name: str, limits: int) -> tuple[bool, bool]:
        """Return whether it is at the lower and at the upper limit; soft ones are none without a reference."""
        soft = name in self._referenced
        return bool(limits & (LOWER_SWITCH | LOWER_SOFT * soft)), bool(limits & (UPPER_SWITCH | UPPER_SOFT * soft))

    def _faults(self, name: str, status: int, limits: int, pulses: int) -> list[str]:
        faults = [self._failed[name]] if name in self._failed else []
        if limits & BOTH_SWITCHES == BOTH_SWITCHES:
            faults.append(f"no stage is connected as {name}")
        target, stops = self._targets.get(name, (pulses, 0))
        if not status & MOVING and pulses != target and stops == self._link.stops:
            axis = self._axes[name]
            faults.append(
                f"{name} stands at {axis.position(pulses):g} and not at {axis.position(target):g} {axis.axis.unit}"
                f"{_why_it_stands(status, limits)}"
            )
        return faults

    def _axis(self, name: str) -> DS102Axis:
        if name not in self._axes:
            raise HardwareError(self.name, f"it has no axis {name}", f"there are: {', '.join(self._axes)}")
        return self._axes[name]

    def _send(self, axis: DS102Axis, command: str, stops: int) -> None:
        self._link.send(f"AXI{axis.number}:{command}", stops=stops)

    def _status(self, axis: DS102Axis, byte: int, stops: int | None = None) -> int:
        status = self._number(axis, f"SB{byte}", stops)
        if not 0 <= status <= 255:
            raise self._senseless(str(status), f"AXI{axis.number}:SB{byte}?")
        return status

    def _number(self, axis: DS102Axis, word: str, stops: int | None = None) -> int:
        query = f"AXI{axis.number}:{word}?"
        return self._integer(self._ask(query, stops), query)

    def _integer(self, reply: str, query: str) -> int:
        match = re.fullmatch(r"\s*([+-]?\d+)(?:\.0*)?\s*", reply)
        if not match:
            raise self._senseless(reply, query)
        return int(match[1])

    def _ask(self, query: str, stops: int | None = None) -> str:
        """Ask, and set error codes aside that come before the reply, or instead of it."""
        if not self._is_in_step:
            self._get_in_step()
        self._is_in_step = False
        reply = self._link.ask(query, stops=stops)
        while ERROR_CODE.search(reply):
            self._look_for_codes(reply)
            try:
                reply = self._link.read_line()
            except ReplyTimeoutError:
                self._raise_codes(query)
        self._is_in_step = True
        return reply

    def _get_in_step(self) -> str:
        """Return its identity, and throw away what comes before: a bare number tells not which query it answers."""
        said = self._link.ask("*IDN?")
        while "SURUGA" not in said:
            self._look_for_codes(said)
            try:
                said = self._link.read_line()
            except ReplyTimeoutError:
                raise ReplyError(
                    self.name, f"{said!r} is not what a DS102 says that it is", "see which port it is on"
                ) from None
        self._is_in_step = True
        return said

    def _look_for_codes(self, text: str) -> None:
        for code in ERROR_CODE.findall(text):
            self._codes.pop(code, None)
            self._codes[code] = None

    def _raise_codes(self, what: str) -> None:
        """Refuse to go on if there have been error codes; they stay the fault of the stage until the next order."""
        if self._codes:
            fault, cure = _fault_and_cure(next(reversed(self._codes)))
            raise RefusedError(self.name, f"{what}: {fault}", cure)

    def _senseless(self, reply: str, query: str) -> ReplyError:
        self._is_in_step = False
        return ReplyError(self.name, f"{reply!r} does not answer {query}", "see to baud rate and cable")


def _fault_and_cure(code: str) -> tuple[str, str]:
    fault, cure = ERRORS.get(code, ("an error that this driver does not know", "look it up in the manual"))
    return f"{fault} ({code})", cure


def _why_it_stands(status: int, limits: int) -> str:
    if limits & (UPPER_SWITCH | UPPER_SOFT):
        return ": it is at its upper limit"
    if limits & (LOWER_SWITCH | LOWER_SOFT):
        return ": it is at its lower limit"
    return ": its drive was cut short" if status & CUT_SHORT else ""
