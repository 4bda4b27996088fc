"""Stages behind controllers of Physik Instrumente that speak the General Command Set 2.0 (C-863, C-867, C-884, E-8xx).

Written from manuals, and from what PI's own programs do; checked against PIPython through the emulator, and on no
device. Known to differ between models and not verified: the baud rate, the bits of the status register and their sense,
``ATZ``, whether all queries are answered during a reference move, and whether several may be written at once, as those
for a state and an order with its ``ERR?`` are. Velocities and accelerations are lost with the power; so are references
and the servo mode, by which a power cycle is noticed.

Source: PI, user manuals MS249E (C-863.12) and MS173E (C-863).
"""

import math
import threading
import time
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from enum import StrEnum

from stage_hardware.drivers.pi_errors import STOPPED, fault_and_cure
from stage_hardware.errors import HardwareError, InterruptedByStopError, RefusedError, ReplyError
from stage_hardware.links.gcs_line import GcsLine, SerialGcsLine
from stage_hardware.stage import Axis, AxisState, Stage, StageState

UNITS_PER_CONTROLLER_UNIT = 1000
"""Controllers count in mm and degrees."""

STATUS, MOTION = "\x04", "\x05"
"""The status registers of all axes, and the mask of those that move, as hexadecimal numbers."""


class Reference(StrEnum):
    """How an axis finds its origin: the command that begins it.

    At the reference switch, at a limit switch, by the automatic zero point procedure of piezo controllers, which may
    take it over all of its travel, or without moving, as its present position is declared.
    """

    SWITCH = "FRF"
    LOWER_LIMIT = "FNL"
    UPPER_LIMIT = "FPL"
    AUTOMATIC_ZERO = "ATZ"
    DECLARED = "POS"


@dataclass(frozen=True)
class PiAxis:
    """One axis of a controller: what it can do, in um or mdeg, and what the controller calls it.

    ``declared`` is where it stands when it is homed by :attr:`Reference.DECLARED`. Controllers that have no ramps, as
    those of piezos, are not sent accelerations: ``has_ramps``. Limit switches that are 0 in the status register when
    they are run onto are ``limits_inverted``, as in an example of the manual MS249E.
    """

    axis: Axis
    identifier: str = "1"
    reference: Reference = Reference.SWITCH
    declared: float = 0.0
    has_ramps: bool = True
    limits_inverted: bool = False

    def __post_init__(self) -> None:
        """Refuse units that the controller does not have."""
        if self.axis.unit not in ("um", "mdeg"):
            raise ValueError(f"an axis of a PI controller is in um or mdeg, got {self.axis.unit!r}")

    def controller_value(self, position: float) -> str:
        """Return a position in mm or degrees, exactly: that of the nearest step that lies within the limits."""
        axis = self.axis
        first, last = math.ceil(axis.lo / axis.resolution - 1e-6), math.floor(axis.hi / axis.resolution + 1e-6)
        count = min(max(round(position / axis.resolution), first), last)
        return f"{count * Decimal(repr(axis.resolution)) / UNITS_PER_CONTROLLER_UNIT:f}"


@dataclass(frozen=True)
class StatusBits:
    """Which bits of an axis' status register of 16 bits say what."""

    on_target: int = 15
    referencing: int = 14
    moving: int = 13
    servo_on: int = 12
    error: int = 8
    upper_limit: int = 2
    lower_limit: int = 0


C_863 = StatusBits()
"""The register of the C-863.12, according to its manual."""


@dataclass(frozen=True)
class _Status:
    """How an axis stands, as far as it was asked."""

    moving: bool
    servo_on: bool
    referencing: bool = False
    at_lower_limit: bool = False
    at_upper_limit: bool = False
    has_error: bool = True


class GcsStage(Stage):
    """A GCS 2.0 controller behind any line.

    ``identity`` is what ``*IDN?`` must contain, such as a model or a serial number. With ``status_bits`` one character
    asks for motion, servo and limit switches of all axes; without, for controllers whose register is laid out
    otherwise, motion, on-target state and servo are asked one by one, and limit switches not at all.

    An axis moves until its profile has ended and it is on target. After a stop, a refusal or a reply that did not come,
    the state is read before the next command goes out.
    """

    def __init__(
        self,
        name: str,
        axes: Mapping[str, PiAxis],
        line: GcsLine,
        *,
        identity: str = "",
        status_bits: StatusBits | None = C_863,
    ) -> None:
        """Remember what is known before connecting."""
        super().__init__(name, {axis_name: axis.axis for axis_name, axis in axes.items()})
        self._axes, self._line, self._identity, self._bits = dict(axes), line, identity, status_bits
        self._identifiers = [axis.identifier for axis in axes.values()]
        self._questions = self._about_state()
        self._lock = threading.RLock()
        self._all_identifiers: list[str] = []  # in the controller's order
        self._referenced: set[str] = set()
        self._error = 0
        self._is_unsure, self._stops_seen = True, 0

    def connect(self) -> None:
        """Open the line, compare controller and limits with what was meant, set speeds and switch the servos on."""
        with self._lock:
            self._line.close()
            self._line.open()
            try:
                self._set_up(self._line.stops)
                self.state()
            except HardwareError:
                self._line.close()
                raise

    def close(self) -> None:
        """Close the line."""
        self._line.close()

    def home(self, axes: Collection[str]) -> None:
        """Begin the reference moves, those of one kind together."""
        stops = self._line.stops
        chosen = [self._axis(name) for name in axes]
        with self._lock:
            self._look_if_unsure(stops)
            for how in Reference:
                if alike := [axis for axis in chosen if axis.reference is how]:
                    self._order(f"{how} {' '.join(map(_reference_argument, alike))}", stops)
            self._is_unsure = True  # whether they are referenced, which a move asks for

    def move_to(self, targets: Mapping[str, float]) -> None:
        """Begin to move; if the controller refuses one axis, none moves."""
        stops = self._line.stops
        words = []
        for name, target in targets.items():
            pi_axis = self._axis(name)
            axis = pi_axis.axis
            if not axis.lo <= target <= axis.hi:
                raise HardwareError(
                    self.name,
                    f"{name} cannot go to {target:g} {axis.unit}, its limits are {axis.lo:g}..{axis.hi:g}",
                    "stay within them",
                )
            words += [pi_axis.identifier, pi_axis.controller_value(target)]
        with self._lock:
            self._look_if_unsure(stops, [self._axes[name].identifier for name in targets])
            for name in targets:
                if self._axes[name].identifier not in self._referenced:
                    raise HardwareError(self.name, f"{name} is not referenced", "home it first")
            if words:
                self._order(" ".join(["MOV", *words]), stops)

    def stop(self) -> None:
        """Stop all axes abruptly, past whatever is under way."""
        self._line.stop_all()

    def state(self) -> StageState:
        """Ask how the axes stand and then where they are: one that moves no more has the position that it will keep."""
        with self._lock:
            stops = self._line.stops
            was_unsure, self._is_unsure = self._is_unsure or stops != self._stops_seen, True
            told = self._ask_about_state()
            time_ns = time.monotonic_ns()
            statuses = self._statuses(told)
            self._referenced = self._references(told, statuses)
            positions = self._values("POS?", self._identifiers, told["POS?"])
            if was_unsure or any(status.has_error for status in statuses.values()):
                self._take_error()  # whose answer is like none of the others: late ones are not taken for these
            self._is_unsure, self._stops_seen = False, stops
            return StageState(
                time_ns,
                {
                    name: AxisState(
                        positions[axis.identifier] * UNITS_PER_CONTROLLER_UNIT,
                        status.moving,
                        axis.identifier in self._referenced,
                        status.at_lower_limit,
                        status.at_upper_limit,
                    )
                    for name, axis in self._axes.items()
                    for status in [statuses[axis.identifier]]
                },
                self._fault(statuses),
            )

    def _set_up(self, stops: int) -> None:
        self._is_unsure, self._referenced = True, set()
        self._take_error()  # what others have left
        self._error = 0
        self._see_identity()
        self._see_axes()
        self._see_limits()
        for axis in self._axes.values():
            for setting, value in _settings(axis):
                self._order(f"{setting} {axis.identifier} {value}", stops)
                there = self._numbers(f"{setting}?", [axis.identifier])[axis.identifier]
                if not math.isclose(there, float(value), rel_tol=0.01):
                    raise HardwareError(
                        self.name,
                        f"{setting} of axis {axis.identifier} is {there:g} after it was set to {value}",
                        "see what the controller allows",
                    )

    def _see_identity(self) -> None:
        identity, version = " ".join(self._line.ask("*IDN?")), self._line.ask("CSV?")[0]
        if self._identity not in identity:
            raise HardwareError(
                self.name, f"it says {identity!r}, where {self._identity!r} is missing", "see which port it is on"
            )
        if not version.startswith("2"):
            raise HardwareError(
                self.name,
                f"it speaks version {version!r} of the General Command Set",
                "use a controller that speaks 2.0",
            )

    def _see_axes(self) -> None:
        self._all_identifiers, configured = self._line.ask("SAI? ALL"), self._line.ask("SAI?")
        for name, axis in self._axes.items():
            if axis.identifier not in configured or axis.identifier not in self._all_identifiers:
                raise HardwareError(
                    self.name,
                    f"{name} is axis {axis.identifier}, and there are: {', '.join(configured)}",
                    "see to the identifiers, and that a stage is configured",
                )

    def _see_limits(self) -> None:
        lower, upper = self._numbers("TMN?", self._identifiers), self._numbers("TMX?", self._identifiers)
        for name, pi_axis in self._axes.items():
            lo, hi = (limits[pi_axis.identifier] * UNITS_PER_CONTROLLER_UNIT for limits in (lower, upper))
            axis = pi_axis.axis
            if axis.lo < lo - axis.resolution / 2 or axis.hi > hi + axis.resolution / 2:
                raise HardwareError(
                    self.name,
                    f"the limits of {name}, {axis.lo:g}..{axis.hi:g} {axis.unit}, "
                    f"are wider than the controller's, {lo:g}..{hi:g}",
                    "narrow them, or see to the parameters of the stage",
                )

    def _about_state(self) -> dict[str, list[str]]:
        """Return what is asked for a state, positions last, and about which axes; characters ask about all."""
        questions: dict[str, list[str]] = {STATUS: []}
        if self._bits is None:
            questions = {MOTION: [], "ONT?": self._identifiers, "SVO?": self._identifiers}
        for axis in self._axes.values():
            query = "ATZ?" if axis.reference is Reference.AUTOMATIC_ZERO else "FRF?"
            questions.setdefault(query, []).append(axis.identifier)
        return {**questions, "POS?": self._identifiers}

    def _ask_about_state(self) -> dict[str, list[str]]:
        answers = self._line.ask_all([" ".join([query, *about]) for query, about in self._questions.items()])
        return dict(zip(self._questions, answers, strict=True))

    def _statuses(self, told: Mapping[str, Sequence[str]]) -> dict[str, _Status]:
        if self._bits is None:
            moving = self._mask(told[MOTION][0])
            on_target, servo_on = self._those("ONT?", told), self._those("SVO?", told)
            return {
                identifier: _Status(
                    bool(moving >> self._all_identifiers.index(identifier) & 1) or identifier in servo_on - on_target,
                    identifier in servo_on,
                )
                for identifier in self._identifiers
            }
        reply = told[STATUS][0]
        register = self._mask(reply)
        if len(reply.removeprefix("0x")) != 4 * len(self._all_identifiers):
            raise self._senseless(reply, "the status registers")
        return {
            axis.identifier: _status(register >> 16 * self._places_from_the_end(axis.identifier), axis, self._bits)
            for axis in self._axes.values()
        }

    def _places_from_the_end(self, identifier: str) -> int:
        """The register of the first axis comes first."""
        return len(self._all_identifiers) - 1 - self._all_identifiers.index(identifier)

    def _references(self, told: Mapping[str, Sequence[str]], statuses: Mapping[str, _Status]) -> set[str]:
        referenced = set[str]().union(*(self._those(query, told) for query in ("FRF?", "ATZ?") if query in told))
        return referenced - {identifier for identifier, status in statuses.items() if status.referencing}

    def _fault(self, statuses: Mapping[str, _Status]) -> str | None:
        faults = [fault_and_cure(self._error)[0]] if self._error else []
        off = [name for name, axis in self._axes.items() if not statuses[axis.identifier].servo_on]
        if off:
            faults.append(f"the servo of {', '.join(off)} is off, by a fault, a power cycle or another program")
        return "; ".join(faults) or None

    def _axis(self, name: str) -> PiAxis:
        if name not in self._axes:
            raise HardwareError(self.name, f"it has no axis {name}", f"there are: {', '.join(self._axes)}")
        return self._axes[name]

    def _look_if_unsure(self, stops: int, identifiers: Iterable[str] = ()) -> None:
        """Read the state if the last one may no longer hold, or does not say that these axes are referenced."""
        if self._is_unsure or stops != self._stops_seen or not self._referenced.issuperset(identifiers):
            self.state()

    def _order(self, command: str, stops: int) -> None:
        """Give an order; whether one that fails was carried out is not known."""
        self._is_unsure = True
        code = self._code(self._line.order(command, stops))
        if code == STOPPED:
            raise InterruptedByStopError(self.name, "a stop came first", "look at the state before the next command")
        if code:
            fault, cure = fault_and_cure(code)
            raise RefusedError(self.name, f"{command!r} is refused: {fault}", cure)
        self._is_unsure, self._error = False, 0

    def _take_error(self) -> None:
        """Ask for the last error, which is cleared by that; that there was a stop is none."""
        code = self._code(self._line.ask("ERR?")[0])
        if code not in (0, STOPPED):
            self._error = code

    def _numbers(self, query: str, identifiers: Sequence[str]) -> dict[str, float]:
        return self._values(query, identifiers, self._line.ask(f"{query} {' '.join(identifiers)}"))

    def _values(self, query: str, identifiers: Sequence[str], lines: Sequence[str]) -> dict[str, float]:
        """Return the numbers in an answer, which must be about these axes."""
        try:
            values = {identifier.strip(): float(value) for identifier, value in (line.split("=") for line in lines)}
        except ValueError:
            raise self._senseless("; ".join(lines), query) from None
        if list(values) != list(identifiers) or not all(map(math.isfinite, values.values())):
            raise self._senseless("; ".join(lines), query)
        return values

    def _those(self, query: str, told: Mapping[str, Sequence[str]]) -> set[str]:
        """Return for which axes the answer is 1 rather than 0."""
        values = self._values(query, self._questions[query], told[query])
        if not set(values.values()) <= {0, 1}:
            raise self._senseless(repr(values), query)
        return {identifier for identifier, value in values.items() if value}

    def _code(self, reply: str) -> int:
        try:
            return int(reply)
        except ValueError:
            raise self._senseless(reply, "ERR?") from None

    def _mask(self, reply: str) -> int:
        try:
            return int(reply, 16)
        except ValueError:
            raise self._senseless(reply, "the status") from None

    def _senseless(self, reply: str, query: str) -> ReplyError:
        self._line.distrust()
        return ReplyError(self.name, f"{reply!r} does not answer {query}", "see to baud rate and cable")


class PiStage(GcsStage):
    """A GCS 2.0 controller at a serial port, or at a TCP port as ``socket://192.168.0.1:50000``.

    The baud rate is set by switches or parameters of the controller, and means nothing to TCP. Controllers in a daisy
    chain, and those that only PI's library reaches, are for :mod:`stage_hardware.drivers.pipython_stage`.
    """

    def __init__(
        self,
        name: str,
        url: str,
        axes: Mapping[str, PiAxis],
        *,
        baud: int = 115200,
        timeout_s: float = 0.5,
        identity: str = "",
        status_bits: StatusBits | None = C_863,
    ) -> None:
        """Remember what is known before connecting."""
        line = SerialGcsLine(name, url, baud=baud, timeout_s=timeout_s)
        super().__init__(name, axes, line, identity=identity, status_bits=status_bits)


def _settings(axis: PiAxis) -> list[tuple[str, str]]:
    """Return what a power cycle loses, in the order in which it is set."""
    settings = []
    if axis.reference is not Reference.AUTOMATIC_ZERO:
        settings.append(("RON", "0" if axis.reference is Reference.DECLARED else "1"))
    settings.append(("VEL", f"{axis.axis.speed / UNITS_PER_CONTROLLER_UNIT:.7f}"))
    if axis.has_ramps:
        settings += [(ramp, f"{axis.axis.acceleration / UNITS_PER_CONTROLLER_UNIT:.7f}") for ramp in ("ACC", "DEC")]
    return [*settings, ("SVO", "1")]


def _reference_argument(axis: PiAxis) -> str:
    match axis.reference:
        case Reference.DECLARED:
            return f"{axis.identifier} {axis.controller_value(axis.declared)}"
        case Reference.AUTOMATIC_ZERO:
            return f"{axis.identifier} NaN"  # the voltage that the controller itself begins with
        case _:
            return axis.identifier


def _status(register: int, axis: PiAxis, bits: StatusBits) -> _Status:
    def is_set(bit: int) -> bool:
        return bool(register >> bit & 1)

    servo_on, referencing = is_set(bits.servo_on), is_set(bits.referencing)
    return _Status(
        is_set(bits.moving) or referencing or (servo_on and not is_set(bits.on_target)),
        servo_on,
        referencing,
        is_set(bits.lower_limit) is not axis.limits_inverted,
        is_set(bits.upper_limit) is not axis.limits_inverted,
        is_set(bits.error),
    )
