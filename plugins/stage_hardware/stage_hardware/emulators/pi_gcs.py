"""An emulated controller of Physik Instrumente that speaks the General Command Set 2.0, with its stages.

It answers what a C-863 is documented to answer, for any number of axes. Not documented, and so guesses: that queries
are answered during a reference move, the error after a limit switch was hit, and the registers of several axes in one
answer, first axis first. Axes arrive without settling, and turn as well as move: the unit is the stage's, mm or degree.

Source: PI, user manuals MS249E (C-863.12) and MS173E (C-863).
"""

import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from stage_hardware.emulators.emulator import Emulator
from stage_hardware.emulators.mechanism import Clock, Mechanism
from stage_hardware.emulators.wire import TcpPort, Wire

SYNTAX, UNKNOWN_COMMAND, NOT_REFERENCED_OR_NO_SERVO, BEYOND_LIMITS, TOO_FAST, STOPPED = 1, 2, 5, 7, 8, 10
NO_SUCH_AXIS, OUT_OF_RANGE, WRONG_NUMBER_OF_PARAMETERS, NOT_A_NUMBER, REFERENCING_IS_OFF = 15, 17, 24, 25, 50
JOYSTICK_ACTIVE, UNKNOWN_PARAMETER, LIMIT_SWITCH_HIT, MOTION_ERROR = 51, 54, 216, -1024

SINGLE_CHARACTERS = b"\x04\x05\x07\x08\x18"
"""Status registers, motion mask, ready, macro running, stop all: recognised wherever they stand, and without an end."""


@dataclass(frozen=True)
class EmulatedStage:
    """What is built into a stage, in mm or degrees: it switches on at ``position``, and its reference switch is at 0.

    Limit switches are ``beyond_travel`` outside its travel ``lo..hi``.
    """

    lo: float = -12.5
    hi: float = 12.5
    position: float = 1.0
    beyond_travel: float = 0.5
    resolution: float = 1e-4
    largest_speed: float = 10.0
    speed: float = 5.0
    acceleration: float = 50.0
    name: str = "M-112.1DG"


class EmulatedAxis:
    """A stage and what the controller knows of it.

    ``mechanism`` can be put in the way of: its ``slowness``, its switches. ``off_target`` is how far from its target it
    stays; ``joystick`` takes it out of the hands of commands; ``limits_inverted`` is the sense of its switches in the
    register.
    """

    def __init__(self, stage: EmulatedStage, clock: Clock) -> None:
        """Put it together; it is switched on by the controller."""
        self.stage = stage
        self.mechanism = Mechanism(
            stage.lo - stage.beyond_travel,
            stage.hi + stage.beyond_travel,
            position=stage.position,
            start_speed=0.0,
            speed=stage.speed,
            acceleration=stage.acceleration,
            clock=clock,
        )
        self.off_target, self.joystick, self.limits_inverted = 0.0, False, False
        self.switch_on()

    def switch_on(self) -> None:
        """Begin as after a power cycle: all that was set is lost."""
        self.mechanism.power_cycle()
        self.speed, self.deceleration = self.stage.speed, self.stage.acceleration
        self.mechanism.speed, self.mechanism.acceleration = self.stage.speed, self.stage.acceleration
        self.servo_on, self.reference_is_needed, self.referenced = False, True, False
        self.referencing: str | None = None
        self.automatic_zero_done = False
        self.target = 0.0

    @property
    def position(self) -> float:
        """Where the controller believes it is."""
        grain = self.stage.resolution
        return round((self.mechanism.counter + self.off_target) / grain) * grain

    @property
    def on_target(self) -> bool:
        """Whether it stands where it should."""
        return (
            self.servo_on
            and not self.mechanism.moving
            and abs(self.position - self.target) <= 2 * self.stage.resolution
        )

    def settle(self) -> int:
        """Take note of what has ended by now, and return the error that came of it."""
        mechanism = self.mechanism
        if mechanism.moving:
            return 0
        how, self.referencing = self.referencing, None
        if how in ("FNL", "FPL") and mechanism.hit_limit:
            mechanism.set_counter(mechanism.position)
            mechanism.hit_limit = False
            self.referenced = True
        elif how in ("FRF", "ATZ") and mechanism.referenced:
            self.referenced = how == "FRF"
            self.automatic_zero_done = how == "ATZ"
        elif mechanism.hit_limit:
            mechanism.hit_limit = False
            self.target = mechanism.counter
            return LIMIT_SWITCH_HIT
        if how:
            self.target = mechanism.counter
        return 0

    def stop(self, *, hard: bool) -> None:
        """Stop, wherever it was going."""
        self.mechanism.stop(hard=hard)
        if self.referencing:
            self.referencing = None
        self.target = self.mechanism.counter
        if self.mechanism.moving:  # it comes to rest after the way of the ramp
            speed = self.mechanism.velocity
            self.target += speed * abs(speed) / (2 * self.mechanism.acceleration)

    def register(self, error: bool) -> int:
        """Return its status register."""
        at_lower = self.mechanism.at_lower_switch is not self.limits_inverted
        at_upper = self.mechanism.at_upper_switch is not self.limits_inverted
        return (
            self.on_target << 15
            | (self.referencing is not None) << 14
            | self.mechanism.moving << 13
            | self.servo_on << 12
            | error << 8
            | at_upper << 2
            | (self.mechanism.position >= 0) << 1
            | at_lower << 0
        )


class _RefusedError(Exception):
    """A command that leaves an error code, and does nothing else."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


class PiEmulator(Emulator):
    """A controller behind a wire, to be used in a ``with``: clients open ``url``.

    Faults of the wire are set on ``faults``; those of the controller are ``refuse_next``, a code that the next command
    that is no query leaves instead of being carried out, and :meth:`switch_servo_off` and :meth:`power_cycle`; those of
    an axis are at ``axes[identifier]``. ``heard`` keeps the last commands and queries, single characters as ``#24``.
    """

    def __init__(
        self,
        stages: Mapping[str, EmulatedStage] | None = None,
        *,
        wire: type[Wire] = TcpPort,
        baud: int = 0,
        processing_s: float = 0.0,
        model: str = "C-863.11",
        clock: Clock = time.monotonic,
    ) -> None:
        """Build it of stages by identifier, by default of one, which is axis 1."""
        super().__init__(wire, baud=baud, processing_s=processing_s)
        built = stages or {"1": EmulatedStage()}
        self.axes = {identifier: EmulatedAxis(stage, clock) for identifier, stage in built.items()}
        self.model, self.error, self.refuse_next = model, 0, 0
        self.heard: deque[str] = deque(maxlen=1000)
        self._line = bytearray()
        self._lock = threading.RLock()
        self._queries = self._all_queries()
        self._commands = self._all_commands()

    def power_cycle(self) -> None:
        """Switch it off and on: positions, references, speeds, servo modes and errors are lost."""
        with self._lock:
            self._line.clear()
            self.error = 0
            for axis in self.axes.values():
                axis.switch_on()

    def switch_servo_off(self, identifier: str) -> None:
        """Let an axis fail as when something holds it: it stops, and its servo goes off."""
        with self._lock:
            self.axes[identifier].stop(hard=True)
            self.axes[identifier].servo_on = False
            self.error = MOTION_ERROR

    def answer(self, data: bytes) -> Iterable[bytes]:
        """Take bytes in pieces of any size, and return the replies that are due."""
        with self._lock:
            replies = []
            for byte in data:
                if byte in SINGLE_CHARACTERS:
                    reply = self._single(byte)
                elif byte == ord("\n"):
                    line, self._line = self._line.decode("cp1252", errors="replace"), bytearray()
                    reply = self._carry_out(line)
                else:
                    self._line.append(byte)
                    continue
                if reply:
                    replies.append(" \n".join(reply).encode("cp1252") + b"\n")
            return replies

    def _single(self, byte: int) -> list[str]:
        self._settle()
        self.heard.append(f"#{byte}")
        axes = list(self.axes.values())
        match byte:
            case 4:
                return ["0x" + "".join(f"{axis.register(self.error != 0):04x}" for axis in axes)]
            case 5:
                return [f"{sum(axis.mechanism.moving << place for place, axis in enumerate(axes)):x}"]
            case 7:
                return ["\xb0" if any(axis.referencing for axis in axes) else "\xb1"]
            case 8:
                return ["0"]
            case _:
                self._stop_all()
                return []

    def _carry_out(self, line: str) -> list[str]:
        self._settle()
        words = line.split()
        if not words:
            return []
        self.heard.append(line)
        name, arguments = words[0].upper(), words[1:]
        try:
            if name == "ERR?":
                code, self.error = self.error, 0
                return [str(code)]
            if name in self._queries:
                return self._queries[name](arguments)
            if self.refuse_next:
                code, self.refuse_next = self.refuse_next, 0
                raise _RefusedError(code)
            if name not in self._commands:
                raise _RefusedError(UNKNOWN_COMMAND)
            self._commands[name](arguments)
        except _RefusedError as refused:
            self.error = refused.code
        return []

    def _settle(self) -> None:
        for axis in self.axes.values():
            self.error = axis.settle() or self.error

    def _all_queries(self) -> dict[str, Callable[[list[str]], list[str]]]:
        return {
            "*IDN?": lambda _: [f"(c)2015 Physik Instrumente (PI) GmbH & Co. KG, {self.model}, 0, 1.2.0"],
            "CSV?": lambda _: ["2.0"],
            "VER?": lambda _: ["FW_ARM: V1.2.0"],
            "SAI?": lambda _: list(self.axes),
            "HLP?": lambda _: ["The following commands are valid:", *self._help(), "end of help"],
            "CST?": self._of_axes(lambda axis: axis.stage.name),
            "TMN?": self._of_axes(lambda axis: f"{axis.stage.lo:.7f}"),
            "TMX?": self._of_axes(lambda axis: f"{axis.stage.hi:.7f}"),
            "POS?": self._of_axes(lambda axis: f"{axis.position:.7f}"),
            "MOV?": self._of_axes(lambda axis: f"{axis.target:.7f}"),
            "VEL?": self._of_axes(lambda axis: f"{axis.speed:.7f}"),
            "ACC?": self._of_axes(lambda axis: f"{axis.mechanism.acceleration:.7f}"),
            "DEC?": self._of_axes(lambda axis: f"{axis.deceleration:.7f}"),
            "ONT?": self._of_axes(lambda axis: f"{axis.on_target:d}"),
            "SVO?": self._of_axes(lambda axis: f"{axis.servo_on:d}"),
            "RON?": self._of_axes(lambda axis: f"{axis.reference_is_needed:d}"),
            "FRF?": self._of_axes(lambda axis: f"{axis.referenced:d}"),
            "ATZ?": self._of_axes(lambda axis: f"{axis.automatic_zero_done:d}"),
            "TRS?": self._of_axes(lambda _: "1"),
            "LIM?": self._of_axes(lambda _: "1"),
            "SRG?": self._registers,
            "SPA?": self._parameters,
        }

    def _all_commands(self) -> dict[str, Callable[[list[str]], None]]:
        return {
            "SVO": self._switch_servo,
            "RON": self._switch_reference_mode,
            "POS": self._declare,
            "VEL": self._set_speed,
            "ACC": self._set_acceleration,
            "DEC": self._set_deceleration,
            "MOV": lambda arguments: self._move(arguments, relative=False),
            "MVR": lambda arguments: self._move(arguments, relative=True),
            "FRF": lambda arguments: self._reference("FRF", self._identifiers(arguments)),
            "FNL": lambda arguments: self._reference("FNL", self._identifiers(arguments)),
            "FPL": lambda arguments: self._reference("FPL", self._identifiers(arguments)),
            "ATZ": self._find_zero,
            "HLT": self._halt,
            "STP": lambda _: self._stop_all(),
        }

    def _help(self) -> list[str]:
        return ["#4", "#5", "#7", "#8", "#24", "ERR?", *sorted([*self._queries, *self._commands])]

    def _of_axes(self, tell: Callable[[EmulatedAxis], str]) -> Callable[[list[str]], list[str]]:
        def query(arguments: list[str]) -> list[str]:
            return [f"{identifier}={tell(self.axes[identifier])}" for identifier in self._identifiers(arguments)]

        return query

    def _registers(self, arguments: list[str]) -> list[str]:
        pairs = self._pairs(arguments) if arguments else [(identifier, "1") for identifier in self.axes]
        if any(register != "1" for _, register in pairs):
            raise _RefusedError(OUT_OF_RANGE)
        return [f"{identifier} 1=0x{self.axes[identifier].register(self.error != 0):04x}" for identifier, _ in pairs]

    def _parameters(self, arguments: list[str]) -> list[str]:
        answers = []
        for identifier, number in self._pairs(arguments):
            stage = self.axes[identifier].stage
            known = {0x0A: stage.largest_speed, 0x14: 1, 0x15: stage.hi, 0x30: stage.lo, 0x32: 0, 0x3C: stage.name}
            try:
                answers.append(f"{identifier} {number}={known[int(number, 0)]}")
            except (KeyError, ValueError):
                raise _RefusedError(UNKNOWN_PARAMETER) from None
        return answers

    def _identifiers(self, arguments: list[str]) -> list[str]:
        if arguments == ["ALL"] or not arguments:
            return list(self.axes)
        if not set(arguments) <= set(self.axes):
            raise _RefusedError(NO_SUCH_AXIS)
        return arguments

    def _pairs(self, arguments: list[str]) -> list[tuple[str, str]]:
        if not arguments or len(arguments) % 2:
            raise _RefusedError(WRONG_NUMBER_OF_PARAMETERS)
        identifiers = self._identifiers(arguments[::2])
        return list(zip(identifiers, arguments[1::2], strict=True))

    def _values(self, arguments: list[str]) -> list[tuple[EmulatedAxis, float]]:
        try:
            return [(self.axes[identifier], float(text)) for identifier, text in self._pairs(arguments)]
        except ValueError:
            raise _RefusedError(NOT_A_NUMBER) from None

    def _switches(self, arguments: list[str]) -> list[tuple[EmulatedAxis, bool]]:
        values = self._values(arguments)
        if any(value not in (0, 1) for _, value in values):
            raise _RefusedError(OUT_OF_RANGE)
        return [(axis, value == 1) for axis, value in values]

    def _switch_servo(self, arguments: list[str]) -> None:
        for axis, on in self._switches(arguments):
            if on is not axis.servo_on:
                axis.stop(hard=True)
            axis.servo_on = on

    def _switch_reference_mode(self, arguments: list[str]) -> None:
        for axis, on in self._switches(arguments):
            axis.referenced = axis.referenced and on is axis.reference_is_needed
            axis.reference_is_needed = on

    def _declare(self, arguments: list[str]) -> None:
        values = self._values(arguments)
        if any(axis.reference_is_needed for axis, _ in values):
            raise _RefusedError(OUT_OF_RANGE)
        for axis, position in values:
            axis.stop(hard=True)
            axis.mechanism.set_counter(position)
            axis.target, axis.referenced = position, True

    def _set_speed(self, arguments: list[str]) -> None:
        values = self._values(arguments)
        if any(not 0 < speed <= axis.stage.largest_speed for axis, speed in values):
            raise _RefusedError(TOO_FAST)
        for axis, speed in values:
            axis.speed = axis.mechanism.speed = speed

    def _set_acceleration(self, arguments: list[str]) -> None:
        for axis, acceleration in self._positive(arguments):
            axis.mechanism.acceleration = acceleration

    def _set_deceleration(self, arguments: list[str]) -> None:
        for axis, deceleration in self._positive(arguments):
            axis.deceleration = deceleration  # it is told, but ramps down as it ramps up

    def _positive(self, arguments: list[str]) -> list[tuple[EmulatedAxis, float]]:
        values = self._values(arguments)
        if any(not value > 0 for _, value in values):
            raise _RefusedError(OUT_OF_RANGE)
        return values

    def _move(self, arguments: list[str], *, relative: bool) -> None:
        moves = [(axis, axis.target + value if relative else value) for axis, value in self._values(arguments)]
        for axis, target in moves:
            if axis.joystick:
                raise _RefusedError(JOYSTICK_ACTIVE)
            if not axis.servo_on or axis.referencing or not (axis.referenced or axis.automatic_zero_done):
                raise _RefusedError(NOT_REFERENCED_OR_NO_SERVO)
            if not axis.stage.lo - 1e-9 <= target <= axis.stage.hi + 1e-9:
                raise _RefusedError(BEYOND_LIMITS)
        for axis, target in moves:
            axis.target = target
            axis.mechanism.move_to(target)

    def _reference(self, how: str, identifiers: list[str]) -> None:
        axes = [self.axes[identifier] for identifier in identifiers]
        if any(not axis.servo_on for axis in axes):
            raise _RefusedError(NOT_REFERENCED_OR_NO_SERVO)
        if any(not axis.reference_is_needed for axis in axes):
            raise _RefusedError(REFERENCING_IS_OFF)
        for axis in axes:
            axis.referenced = axis.automatic_zero_done = axis.mechanism.referenced = False
            axis.referencing = how
            if how in ("FRF", "ATZ"):
                axis.mechanism.home()
            else:
                axis.mechanism.jog(1 if how == "FPL" else -1)

    def _find_zero(self, arguments: list[str]) -> None:
        self._reference("ATZ", [identifier for identifier, _ in self._pairs(arguments)])

    def _halt(self, arguments: list[str]) -> None:
        for identifier in self._identifiers(arguments):
            self.axes[identifier].stop(hard=False)
        self.error = STOPPED

    def _stop_all(self) -> None:
        for axis in self.axes.values():
            axis.stop(hard=True)
        self.error = STOPPED
