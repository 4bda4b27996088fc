"""Emulated controllers of Micos, with their stages: Corvus, which speaks Venus-1, Pollux and SMC, which speak Venus-2.

A program in reverse Polish, word by word, in the order in which they come. Motions begin and the next word is read, but
a word that begins a motion waits for the one before, and all words after it wait too, stops among them: byte 0x03 does
not.

Not documented, and so guesses: that byte 0x03 throws away the words that wait; that each axis of Venus-2 waits for
itself only; that ``setnpos`` counts as ``setpos`` does; that ``nidentify`` is there; the limits before they were
measured; the order of ``getlimit``; what is left on the stack after an error; the length of a microstep, the serial
number, and the codes of machine errors. Error codes 1 to 4, 1003, 1008, 1010 and 1015 never occur. Whether ``cal`` and
``rm`` hold up other words is not known either: ``cal_blocks``.

Source: SMC Corvus eco manual, pages 44 and 46, and what published programs for these controllers send and expect.
"""

import copy
import re
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from math import hypot, isclose, isinf

from stage_hardware.emulators.emulator import Emulator
from stage_hardware.emulators.mechanism import Clock, Mechanism
from stage_hardware.emulators.wire import TcpPort, Wire

WRONG_TYPE, TOO_FEW_ARGUMENTS, OUT_OF_LIMITS, OUT_OF_RANGE, STACK_FULL, UNKNOWN_WORD = (
    1001, 1002, 1004, 1007, 1009, 2000,
)  # fmt: skip

MOTOR_FAILED = 1
"""A machine error; the number is ours."""

STACK_SIZE = 99
WIDE_mm = 16_383.0
"""How far the limits are on both sides of where an axis is switched on."""

MICROSTEPS_PER_TURN = 40_000
CORVUS_AXES = 3

EXECUTING, MANUAL, MACHINE_ERROR, MOTOR_DISABLED = 0x01, 0x02, 0x04, 0x80
"""Bits of the status of an axis of Venus-2; of Venus-1, the first alone."""

BREAK = b"\x03"
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_LENGTHS_mm = {1: 1e-3, 2: 1.0, 3: 10.0, 4: 1000.0, 5: 25.4, 6: 0.0254}
"""The units by number; 0 stands for microsteps."""


@dataclass(frozen=True)
class EmulatedStage:
    """What is built in, in mm: it travels from 0 to ``length``, and is at ``position`` when it is switched on.

    Its switches are ``beyond_travel`` outside.
    """

    length: float = 50.0
    position: float = 10.0
    beyond_travel: float = 0.1
    speed: float = 10.0
    largest_speed: float = 100.0
    acceleration: float = 100.0
    largest_acceleration: float = 10_000.0


class EmulatedAxis:
    """A stage and what the controller knows of it.

    ``mechanism`` can be put in the way of: its ``slowness``, its switches. ``manual`` is a bit of the status in
    Venus-2.
    """

    def __init__(self, stage: EmulatedStage, clock: Clock) -> None:
        """Put it together, and switch it on."""
        self.stage = stage
        self.mechanism = Mechanism(
            -stage.beyond_travel,
            stage.length + stage.beyond_travel,
            position=stage.position,
            start_speed=0.0,
            speed=stage.speed,
            acceleration=stage.acceleration,
            clock=clock,
        )
        self.manual = False
        self.switch_on()

    def switch_on(self) -> None:
        """Begin as after a power cycle: position, limits and what was set are lost."""
        self.mechanism.power_cycle()
        self.speed, self.acceleration = self.stage.speed, self.stage.acceleration
        here = self.mechanism.position
        self._limits = here - WIDE_mm, here + WIDE_mm  # where they are, whatever the counter is
        self.found, self._looks_for = 0, 0
        self.machine_error = 0

    @property
    def limits(self) -> tuple[float, float]:
        """The range that targets must be in, as the counter counts."""
        lo, hi = self._limits
        return lo - self.mechanism.zero, hi - self.mechanism.zero

    @limits.setter
    def limits(self, limits: tuple[float, float]) -> None:
        lo, hi = limits
        self._limits = lo + self.mechanism.zero, hi + self.mechanism.zero

    def begin(self, target: float, share: float = 1.0) -> None:
        """Begin a motion with a share of speed and acceleration, so that several axes arrive together."""
        self._looks_for = 0
        self.mechanism.speed, self.mechanism.acceleration = self.speed * share, self.acceleration * share
        self.mechanism.move_to(target)

    def look_for(self, end: int) -> None:
        """Begin to run to an end of the travel: 1 for the lower one, where the counter becomes 0, 2 for the upper."""
        self.mechanism.speed, self.mechanism.acceleration = self.stage.speed, self.stage.acceleration
        if end == 1:
            self.mechanism.home()
        else:
            self.mechanism.move_to(self.stage.length - self.mechanism.zero)
        self._looks_for = end

    def settle(self) -> None:
        """Take note of an end that was found by now."""
        if not self._looks_for or self.mechanism.moving:
            return
        end, self._looks_for = self._looks_for, 0
        there = 0.0 if end == 1 else self.stage.length
        if isclose(self.mechanism.position, there, abs_tol=1e-9):
            self.found |= end
            lo, hi = self._limits
            self._limits = (there, hi) if end == 1 else (lo, there)

    @property
    def is_looking(self) -> bool:
        """Whether it is on its way to an end of the travel."""
        self.settle()
        return self._looks_for != 0

    def stop(self) -> None:
        """Come to rest with its acceleration."""
        self.mechanism.stop(hard=False)
        self._looks_for = 0


@dataclass
class Settings:
    """What ``save`` keeps through a power cycle; units are those of the axes and that of speeds."""

    mode: int = 0
    dimension: int = CORVUS_AXES
    units: list[int] = field(default_factory=lambda: [2] * (CORVUS_AXES + 1))
    enabled: list[int] = field(default_factory=lambda: [1] * CORVUS_AXES)
    joystick: bool = False
    speed: float = 10.0
    acceleration: float = 100.0
    service: dict[tuple[str, int], float] = field(default_factory=dict)


class _RefusedError(Exception):
    """A word that leaves an error code, and does nothing else."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


@dataclass(frozen=True)
class _Word:
    """How many arguments a word takes, None for one per dimension, and what it does with them.

    The axis comes last, if there is one. A motion waits for the one before.
    """

    takes: int | None
    run: Callable[..., str | None]
    is_motion: bool = False


class VenusEmulator(Emulator):
    """A controller behind a wire, to be used in a ``with``: clients open ``url``.

    ``venus`` is 1 for a Corvus, with up to three stages, and 2 for a Pollux or an SMC. Faults of the wire are set on
    ``faults``; those of the controller are ``refuse_next``, a code that the next motion leaves instead of being carried
    out, :meth:`switch_motor_off` and :meth:`power_cycle`; those of an axis are at ``axes[number]``, numbers beginning
    with 1. ``heard`` keeps the last words and numbers that were carried out.
    """

    def __init__(
        self,
        stages: Sequence[EmulatedStage] = (EmulatedStage(), EmulatedStage(), EmulatedStage()),
        *,
        venus: int = 1,
        wire: type[Wire] = TcpPort,
        baud: int = 0,
        processing_s: float = 0.0,
        terminal_mode: bool = False,
        cal_blocks: bool = False,
        clock: Clock = time.monotonic,
    ) -> None:
        """Build it; one that wakes up in terminal mode echoes all bytes until it is told ``0 mode``."""
        if venus not in (1, 2) or not 1 <= len(stages) <= (CORVUS_AXES if venus == 1 else 16):
            raise ValueError(f"a controller speaks Venus 1, with 1 to 3 stages, or Venus 2, got {venus}, {len(stages)}")
        super().__init__(wire, baud=baud, processing_s=processing_s)
        self.axes = {number: EmulatedAxis(stage, clock) for number, stage in enumerate(stages, 1)}
        self.venus, self.cal_blocks, self.refuse_next = venus, cal_blocks, 0
        self.heard: deque[str] = deque(maxlen=1000)
        self.saved = Settings(mode=int(terminal_mode), dimension=len(stages))
        self.settings = copy.deepcopy(self.saved)
        self._text, self._waiting = "", deque[str]()
        self._stack: list[float] = []
        self._errors: dict[int, int] = {}  # by axis; all axes of Venus-1 share 0
        self._together: list[EmulatedAxis] = []
        self._lock = threading.RLock()
        self._words = self._venus_1() if venus == 1 else self._venus_2()

    def power_cycle(self) -> None:
        """Switch it off and on: positions, limits, words that wait and all that was not saved are lost."""
        with self._lock:
            self.faults.deaf = False
            self.settings = copy.deepcopy(self.saved)
            self._throw_away()
            self._errors.clear()
            self._together = []
            for axis in self.axes.values():
                axis.switch_on()

    def switch_motor_off(self, number: int) -> None:
        """Let the motor of an axis fail: it stands, and takes no motion until the next power cycle."""
        with self._lock:
            axis = self.axes[number]
            axis.mechanism.stop(hard=True)
            axis.mechanism.motor_on, axis.machine_error = False, MOTOR_FAILED

    def push_joystick(self, number: int, direction: int) -> None:
        """Let somebody push the joystick and hold it: if it is on, the axis moves up (1) or down (-1)."""
        with self._lock:
            if self.settings.joystick:
                self.axes[number].mechanism.jog(direction)

    def answer(self, data: bytes) -> Iterable[bytes]:
        """Take bytes in pieces of any size, and return the replies that are due."""
        with self._lock:
            replies = [data] if self.settings.mode == 1 else []
            for part in re.split(b"(\x03)", data):
                if part == BREAK:
                    self._stop_all()
                    self._throw_away()
                else:
                    *words, self._text = re.split(r"[ \t\r\n]", self._text + part.decode("ascii", errors="replace"))
                    self._waiting += filter(None, words)
                replies += self._run()
            return replies

    def later(self) -> Iterable[bytes]:
        """Return the replies of words that have waited and need to wait no longer."""
        with self._lock:
            return self._run()

    def _throw_away(self) -> None:
        self._text = ""
        self._waiting.clear()
        self._stack.clear()

    def _run(self) -> list[bytes]:
        """Carry out the words that wait for nothing."""
        replies = []
        self._settle()
        while self._waiting and not self._has_to_wait(self._waiting[0]):
            word = self._waiting.popleft()
            self.heard.append(word)
            try:
                reply = self._carry_out(word)
            except _RefusedError as refused:
                self._note(refused.code, None)
                self._stack.clear()
            else:
                if reply is not None:
                    replies.append(reply.encode("ascii") + b"\r\n")
        return replies

    def _has_to_wait(self, text: str) -> bool:
        if self.faults.deaf:
            return True
        axes = list(self.axes.values())
        if self.cal_blocks and any(axis.is_looking for axis in axes):
            return True
        word = self._words.get(text)
        if word is None or not word.is_motion:
            return False
        if self.venus == 2:
            axes = [axis for number, axis in self.axes.items() if self._stack[-1:] == [number]]
        return any(axis.mechanism.moving for axis in axes)

    def _settle(self) -> None:
        """Take note of what motions have led to; a switch that one axis runs onto stops those that move with it."""
        if any(axis.mechanism.hit_limit for axis in self._together if not axis.mechanism.moving):
            for axis in self._together:
                axis.mechanism.stop(hard=True)
            self._together = []
        for axis in self.axes.values():
            axis.settle()

    def _carry_out(self, text: str) -> str | None:
        if _NUMBER.fullmatch(text):
            if len(self._stack) == STACK_SIZE:
                raise _RefusedError(STACK_FULL)
            value = float(text)
            if isinf(value):
                raise _RefusedError(OUT_OF_RANGE)
            self._stack.append(value)
            return None
        word = self._words.get(text)
        if word is None:
            raise _RefusedError(UNKNOWN_WORD)
        takes = self.settings.dimension if word.takes is None else word.takes
        if len(self._stack) < takes:
            raise _RefusedError(TOO_FEW_ARGUMENTS)
        arguments = self._stack[len(self._stack) - takes :]
        del self._stack[len(self._stack) - takes :]
        try:
            if word.is_motion and self.refuse_next:
                code, self.refuse_next = self.refuse_next, 0
                raise _RefusedError(code)
            return word.run(*arguments)
        except _RefusedError as refused:
            self._note(refused.code, arguments[-1] if arguments else None)
            return None

    def _note(self, code: int, axis: float | None) -> None:
        """Keep an error: of Venus-2 for an axis, if it is known for which."""
        if self.venus == 1:
            self._errors[0] = code
        elif axis in self.axes:
            self._errors[int(axis)] = code
        else:
            self._errors |= dict.fromkeys(self.axes, code)

    def _venus_1(self) -> dict[str, _Word]:
        words = {
            "mode": _Word(1, lambda mode: self._set("mode", _whole(mode, 0, 1))),
            "setdim": _Word(1, lambda count: self._set("dimension", _whole(count, 1, len(self.axes)))),
            "getdim": _Word(0, lambda: str(self.settings.dimension)),
            "setaxis": _Word(2, self._enable),
            "getaxis": _Word(1, lambda n: self._listed(n, self.settings.enabled)),
            "setunit": _Word(2, self._set_unit),
            "getunit": _Word(1, self._units),
            "move": _Word(None, lambda *targets: self._move(targets, relative=False), is_motion=True),
            "rmove": _Word(None, lambda *ways: self._move(ways, relative=True), is_motion=True),
            "pos": _Word(0, self._positions),
            "status": _Word(0, lambda: f"{any(axis.mechanism.moving for axis in self.axes.values()):d}"),
            "setvel": _Word(1, self._set_speed),
            "getvel": _Word(0, lambda: _written(self.settings.speed / self._unit(0))),
            "setaccel": _Word(1, self._set_acceleration),
            "getaccel": _Word(0, lambda: _written(self.settings.acceleration / self._unit(0))),
            "abort": _Word(0, self._stop_all),
            "cal": _Word(0, lambda: self._look_for_all(1), is_motion=True),
            "rm": _Word(0, lambda: self._look_for_all(2), is_motion=True),
            "getcaldone": _Word(1, lambda n: str(self._axis(n).found)),
            "setpos": _Word(None, self._shift_all),
            "getlimit": _Word(0, lambda: "\r\n".join(self._limits(n) for n in self._dimensions())),
            "setlimit": _Word(6, self._set_all_limits),
            "geterror": _Word(0, lambda: self._take_error(0)),
            "getmerror": _Word(0, self._take_machine_error),
            "identify": _Word(0, lambda: "Corvus 1 462 1 380"),
            "version": _Word(0, lambda: "2.62"),
            "getserialno": _Word(0, lambda: "1234"),
            "getsw": _Word(1, lambda n: "0 0" if self._axis(n) else None),
            "getswst": _Word(1, self._switches),
            "joystick": _Word(1, lambda on: self._set("joystick", bool(_whole(on, 0, 1)))),
            "getjoystick": _Word(0, lambda: f"{self.settings.joystick:d}"),
            "save": _Word(0, self._save),
            "restore": _Word(0, self._restore),
            "reset": _Word(0, self.power_cycle),
            "clear": _Word(0, self._stack.clear),
            "speed": _Word(None, self._crash),
        }
        for name, first in (("mp", 1.0), ("pitch", 1.0), ("polepairs", 50.0), ("cloop", 0.0)):
            words |= self._service(name, first)
        words |= {
            short: words[long]
            for short, long in {
                "m": "move", "r": "rmove", "p": "pos", "st": "status", "sv": "setvel", "gv": "getvel",
                "sa": "setaccel", "ga": "getaccel", "ge": "geterror", "gme": "getmerror", "j": "joystick",
            }.items()
        }  # fmt: skip
        return words | {name: word for name, word in self._by_axis().items() if name in _OF_ONE_AXIS_IN_VENUS_1}

    def _venus_2(self) -> dict[str, _Word]:
        words = self._by_axis() | {
            "nstatus": _Word(1, self._status),
            "setnvel": _Word(2, self._set_speed),
            "getnvel": _Word(1, lambda n: _written(self._axis(n).speed)),
            "setnaccel": _Word(2, self._set_acceleration),
            "getnaccel": _Word(1, lambda n: _written(self._axis(n).acceleration)),
            "nabort": _Word(1, lambda n: self._axis(n).stop()),
            "setnpos": _Word(2, self._shift),
            "setnlimit": _Word(3, self._set_limits),
            "getnerror": _Word(1, lambda n: self._take_error(self._number(n))),
            "nmode": _Word(1, lambda mode: self._set("mode", _whole(mode, 0, 1))),
            "nidentify": _Word(1, lambda n: "Pollux 1 462 1 380" if self._axis(n) else None),
        }
        return words | {
            short: words[long]
            for short, long in {
                "nm": "nmove", "nr": "nrmove", "np": "npos", "nst": "nstatus", "snv": "setnvel", "gnv": "getnvel",
                "sna": "setnaccel", "gna": "getnaccel", "gne": "getnerror",
            }.items()
        }  # fmt: skip

    def _by_axis(self) -> dict[str, _Word]:
        return {
            "nmove": _Word(2, lambda target, n: self._move_one(target, n, relative=False), is_motion=True),
            "nrmove": _Word(2, lambda way, n: self._move_one(way, n, relative=True), is_motion=True),
            "npos": _Word(1, lambda n: _written(self._axis(n).mechanism.counter / self._unit(self._number(n)))),
            "ncal": _Word(1, lambda n: self._axis(n).look_for(1), is_motion=True),
            "nrm": _Word(1, lambda n: self._axis(n).look_for(2), is_motion=True),
            "getnlimit": _Word(1, lambda n: self._limits(self._number(n))),
        }

    def _service(self, name: str, first: float) -> dict[str, _Word]:
        def write(value: float, n: float) -> None:
            if name == "pitch" and value <= 0:
                raise _RefusedError(OUT_OF_RANGE)
            self.settings.service[name, self._number(n)] = value

        return {
            f"set{name}": _Word(2, write),
            f"get{name}": _Word(1, lambda n: f"{self.settings.service.get((name, self._number(n)), first):g}"),
        }

    def _number(self, n: float) -> int:
        return _whole(n, 1, len(self.axes))

    def _axis(self, n: float) -> EmulatedAxis:
        return self.axes[self._number(n)]

    def _dimensions(self) -> range:
        return range(1, self.settings.dimension + 1)

    def _unit(self, number: int) -> float:
        """Return the length in mm of the unit of an axis, or of that of speeds if it is 0."""
        if self.venus == 2:
            return 1.0
        unit = self.settings.units[number - 1]
        pitch = self.settings.service.get(("pitch", number), 1.0)
        return _LENGTHS_mm[unit] if unit else pitch / MICROSTEPS_PER_TURN

    def _set(self, name: str, value: float) -> None:
        setattr(self.settings, name, value)

    def _enable(self, how: float, n: float) -> None:
        self.settings.enabled[self._number(n) - 1] = _whole(how, 0, 4)

    def _listed(self, n: float, values: Sequence[int]) -> str:
        return " ".join(map(str, values)) if n == -1 else str(values[self._number(n) - 1])

    def _set_unit(self, unit: float, n: float) -> None:
        number, units = _whole(n, -1, CORVUS_AXES), self.settings.units
        for place in range(len(units)) if number == -1 else [number - 1]:
            units[place] = _whole(unit, 0, 6)

    def _units(self, n: float) -> str:
        number, units = _whole(n, -1, CORVUS_AXES), self.settings.units
        return " ".join(map(str, units)) if number == -1 else str(units[number - 1])

    def _positions(self) -> str:
        return " ".join(_written(self.axes[n].mechanism.counter / self._unit(n)) for n in self._dimensions())

    def _limits(self, number: int) -> str:
        return " ".join(_written(limit / self._unit(number)) for limit in self.axes[number].limits)

    def _move(self, values: Sequence[float], *, relative: bool) -> None:
        """Move all axes that are on along a straight line, with the speed along it."""
        moves = {
            n: value * self._unit(n) + (self.axes[n].mechanism.counter if relative else 0.0)
            for n, value in zip(self._dimensions(), values, strict=True)
            if self.settings.enabled[n - 1] == 1
        }
        for n, target in moves.items():
            self._see_within(n, target)
        ways = {n: abs(target - self.axes[n].mechanism.counter) for n, target in moves.items()}
        whole = hypot(*ways.values())
        self._together = []
        for n, target in moves.items():
            if ways[n]:
                axis = self.axes[n]
                self._together.append(axis)
                axis.speed, axis.acceleration = self.settings.speed, self.settings.acceleration
                axis.begin(target, ways[n] / whole)

    def _move_one(self, value: float, n: float, *, relative: bool) -> None:
        axis, number = self._axis(n), self._number(n)
        target = value * self._unit(number) + (axis.mechanism.counter if relative else 0.0)
        self._see_within(number, target)
        if self.venus == 1:
            axis.speed, axis.acceleration = self.settings.speed, self.settings.acceleration
        self._together = []
        axis.begin(target)

    def _see_within(self, number: int, target: float) -> None:
        lo, hi = self.axes[number].limits
        if not lo - 1e-9 <= target <= hi + 1e-9:
            raise _RefusedError(OUT_OF_LIMITS)

    def _set_speed(self, speed: float, n: float = 0) -> None:
        value = speed * self._unit(0)
        axes = [self._axis(n)] if n else list(self.axes.values())
        if not 0 < value <= min(axis.stage.largest_speed for axis in axes):
            raise _RefusedError(OUT_OF_RANGE)
        if n:
            axes[0].speed = value
        else:
            self.settings.speed = value

    def _set_acceleration(self, acceleration: float, n: float = 0) -> None:
        value = acceleration * self._unit(0)
        axes = [self._axis(n)] if n else list(self.axes.values())
        if not 0 < value <= min(axis.stage.largest_acceleration for axis in axes):
            raise _RefusedError(OUT_OF_RANGE)
        if n:
            axes[0].acceleration = value
        else:
            self.settings.acceleration = value

    def _look_for_all(self, end: int) -> None:
        self._together = []
        for n in self._dimensions():
            if self.settings.enabled[n - 1] == 1:
                self.axes[n].look_for(end)

    def _shift(self, distance: float, n: float) -> None:
        """Let the origin be at a distance from here."""
        way = distance * self._unit(self._number(n))
        if abs(way) > WIDE_mm:
            raise _RefusedError(OUT_OF_RANGE)
        self._axis(n).mechanism.set_counter(-way)

    def _shift_all(self, *distances: float) -> None:
        for n, distance in zip(self._dimensions(), distances, strict=True):
            self._shift(distance, n)

    def _set_limits(self, lo: float, hi: float, n: float) -> None:
        if not lo < hi:
            raise _RefusedError(OUT_OF_RANGE)
        unit = self._unit(self._number(n))
        self._axis(n).limits = lo * unit, hi * unit

    def _set_all_limits(self, *limits: float) -> None:
        for n, lo, hi in zip(self._dimensions(), limits[:CORVUS_AXES], limits[CORVUS_AXES:], strict=False):
            self._set_limits(lo, hi, n)

    def _status(self, n: float) -> str:
        axis = self._axis(n)
        return str(
            EXECUTING * axis.mechanism.moving
            | MANUAL * axis.manual
            | MACHINE_ERROR * (axis.machine_error != 0)
            | MOTOR_DISABLED * (not axis.mechanism.motor_on)
        )

    def _switches(self, n: float) -> str:
        mechanism = self._axis(n).mechanism
        return f"{mechanism.at_lower_switch:d} {mechanism.at_upper_switch:d}"

    def _take_error(self, number: int) -> str:
        return str(self._errors.pop(number, 0))

    def _take_machine_error(self) -> str:
        for axis in self.axes.values():
            if code := axis.machine_error:
                axis.machine_error = 0
                return str(code)
        return "0"

    def _stop_all(self) -> None:
        for axis in self.axes.values():
            axis.stop()

    def _save(self) -> None:
        self.saved = copy.deepcopy(self.settings)

    def _restore(self) -> None:
        self.settings = copy.deepcopy(self.saved)

    def _crash(self, *_: float) -> None:
        """Hear nothing more: velocity mode has crashed some controllers."""
        self.faults.deaf = True


_OF_ONE_AXIS_IN_VENUS_1 = {"nmove", "nrmove", "npos", "ncal", "nrm", "getnlimit"}


def _whole(value: float, lo: int, hi: int) -> int:
    if not float(value).is_integer():
        raise _RefusedError(WRONG_TYPE)
    if not lo <= value <= hi:
        raise _RefusedError(OUT_OF_RANGE)
    return int(value)


def _written(value: float) -> str:
    return f"{round(value, 6) + 0.0:.6f}"  # never -0
