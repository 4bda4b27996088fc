"""Drives controllers of Micos that speak Venus-1 (Corvus) or Venus-2 (Pollux, SMC Pollux).

Protocol: Micro-Manager's and EPICS' adapters, a manual of the Corvus eco, and drivers of others. Not tried on a device.
Uncertain: whether status words are answered while an axis looks for its switch (if not, :meth:`VenusStage.state` raises
a ReplyTimeoutError until it has found it), the unit of velocities on a Corvus (it is taken from the last number of
`getunit`), what `getswst` tells (the lower switch first), that a Corvus takes `st p` at once, and bit 0x40 of Venus-2,
taken for an end of travel. Venus-2 has mm and degrees without a choice, and no known words that read back accelerations
and limits.

Writes are not acknowledged: after each the error is asked for, which reading clears. A second move would queue behind
the first and hold up all that follows, so an axis under way is refused another. Corvus tells whether it has found its
origins, and this is lost with the power; a Pollux that was switched off is known by its speeds, if those at power-on
are others than were set, and both by an axis that rests where it was not sent.
"""

import math
import threading
import time
from abc import abstractmethod
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from decimal import Decimal
from fractions import Fraction

from stage_hardware.drivers.venus_words import LENGTHS_MM, MM, Bits, told
from stage_hardware.errors import HardwareError, RefusedError, ReplyError, ReplyTimeoutError
from stage_hardware.links.serial_link import SerialLink
from stage_hardware.stage import Axis, AxisState, Stage, StageState

RESTART_NS = 500_000_000
"""A controller that answered less than this ago has not been restarted meanwhile."""

FRESH_NS = 100_000_000
"""Axes that were seen at rest less than this ago, and were told nothing since, are not asked once more."""

UNITS_PER_CONTROLLER_UNIT = 1000
"""Controllers count in mm and degrees."""

RESTART, ERROR = "restart of the controller", "error of the controller"
"""Under which faults are kept that are of no axis."""

BREAK = b"\x03"
"""Ends a word that holds up others."""


@dataclass(frozen=True)
class VenusAxis:
    """An axis in um or mdeg, the ``number`` of its connector (from 1), and where its lower switch is.

    That switch is the origin of the controller and at ``origin`` in the coordinates of the axis. An axis may rest
    within ``tolerance`` of its target, by default 5 times its resolution.
    """

    axis: Axis
    number: int = 1
    origin: float = 0.0
    tolerance: float | None = None

    def __post_init__(self) -> None:
        """Refuse units that the controller does not have, and what is beyond the switch."""
        if self.axis.unit not in ("um", "mdeg"):
            raise ValueError(f"an axis of a Venus controller is in um or mdeg, got {self.axis.unit!r}")
        if self.number < 1:
            raise ValueError(f"connectors are numbered from 1, got {self.number}")
        if self.axis.lo < self.origin:
            raise ValueError(f"an axis ends above its lower switch at {self.origin:g}, got {self.axis.lo:g}")

    def controller_value(self, position: float) -> str:
        """Return a position in mm or degrees from the switch, exactly: that of the nearest step within the limits."""
        step, origin = Fraction(repr(self.axis.resolution)), Fraction(repr(self.origin))
        first = math.ceil((Fraction(repr(self.axis.lo)) - origin) / step)
        last = math.floor((Fraction(repr(self.axis.hi)) - origin) / step)
        count = min(max(round((Fraction(position) - origin) / step), first), last)
        return f"{count * Decimal(repr(self.axis.resolution)) / UNITS_PER_CONTROLLER_UNIT:f}"

    def position(self, controller_value: float) -> float:
        """Return the position of what the controller tells."""
        return controller_value * UNITS_PER_CONTROLLER_UNIT + self.origin

    def is_near(self, position: float, other: float) -> bool:
        """Return whether two positions may be the same."""
        return abs(position - other) <= (5 * self.axis.resolution if self.tolerance is None else self.tolerance)


@dataclass(frozen=True)
class Reading:
    """What a controller says at ``time_ns`` of the monotonic clock: positions, who moves, ends of travel, faults."""

    time_ns: int
    positions: Mapping[str, float]
    moving: Collection[str]
    at_lower: Collection[str] = ()
    at_upper: Collection[str] = ()
    faults: Mapping[str, str] = field(default_factory=dict)


class VenusStage(Stage):
    """What both dialects have in common.

    Axes must be homed after each :meth:`connect`, as the controller does not tell what was done to its coordinates.
    """

    words_end = b" "
    tells_origins = True
    """Whether it tells that an axis has found its switch since it was switched on."""

    def __init__(self, name: str, url: str, axes: Mapping[str, VenusAxis], *, baud: int, timeout_s: float) -> None:
        """Take axes by name, each at a connector of its own."""
        numbers = [axis.number for axis in axes.values()]
        if not axes or len(set(numbers)) < len(numbers):
            raise ValueError(f"axes have connectors of their own, got {numbers}")
        super().__init__(name, {key: axis.axis for key, axis in axes.items()})
        self.link = SerialLink(name, url, baud=baud, ends=self.words_end, reply_ends=b"\r\n", timeout_s=timeout_s)
        self._axes = dict(axes)
        self._turn = threading.Lock()  # of commands that take several transactions; a stop does not wait for it
        self._forget()

    def _forget(self) -> None:
        self._referenced: set[str] = set()
        self._homing: set[str] = set()
        self._to_home: list[str] = []
        self._sent: set[str] = set()  # whoever was set in motion and has not been seen at rest since
        self._rests_at: dict[str, float] = {}  # where an axis is or will be at rest; absent if not known
        self._direction: dict[str, int] = {}
        self._faults: dict[str, str] = {}  # by axis, or RESTART or ERROR
        self._restarted = False
        self._answered_ns = 0
        self._at_rest: Reading | None = None  # what was read last, if nothing moved and nothing was sent since
        self._stops = self.link.stops

    def connect(self) -> None:
        """Open the link, see that the controller is the one that was meant, and write units and speeds."""
        with self._turn:
            self.link.close()
            self.link.open()
            try:
                self._forget()
                self._enter_host_mode(self.link.stops)
                self._identify()
                if self._read().moving:
                    raise HardwareError(self.name, "it moves already", "stop it, or wait, then connect again")
                self._set_up(self.link.stops)
                self._answered_ns = time.monotonic_ns()
            except BaseException:
                self.link.close()
                raise

    def close(self) -> None:
        """Close the link; safe to call at any time, and twice."""
        self.link.close()

    def stop(self) -> None:
        """Stop all axes: a byte that ends what holds the controller up, and then the word for it."""
        self.link.urgent(BREAK + self._abort() + self.words_end, is_answered=False)

    def state(self) -> StageState:
        """Ask where all axes are; also goes on to the next origin that :meth:`home` was to look for."""
        with self._turn:
            reading = self._observe()
            if self._to_home and not self._sent:
                next_one = self._to_home[0]
                try:
                    self._home_next()
                except RefusedError as error:
                    self._to_home.clear()
                    self._faults[next_one] = error.fault
            states = {name: self._axis_state(name, reading) for name in self.axes}
            faults = [*self._faults.values(), *reading.faults.values()]
            is_at_rest = not (faults or reading.moving or self._sent or self._homing or self._to_home)
            self._at_rest = reading if is_at_rest else None
            return StageState(reading.time_ns, states, "; ".join(faults) or None)

    def home(self, axes: Collection[str]) -> None:
        """Begin to look for the lower switches of some axes; they are referenced when they move no more.

        What the controller cannot begin at the same time, it begins when :meth:`state` has found the axis before at
        its switch.
        """
        stops = self.link.stops
        with self._turn:
            self._refuse_unknown(axes)
            chosen = [name for name in self.axes if name in axes]
            if not chosen:
                return
            self._at_rest = None
            self._refuse_if_unable(chosen, self._observe())
            if self._restarted:
                self._enter_host_mode(stops)
                self._set_up(stops)
                self._restarted = False
            self._to_home, self._home_stops = chosen, stops
            for key in (RESTART, ERROR, *chosen):
                self._faults.pop(key, None)
            self._home_next()

    def move_to(self, targets: Mapping[str, float]) -> None:
        """Begin to move some axes to absolute positions, in their units; they arrive at the nearest step."""
        stops = self.link.stops
        with self._turn:
            self._refuse_targets(targets, self._referenced)
            if not targets:
                return
            reading, self._at_rest = self._just_seen_at_rest() or self._observe(), None
            self._refuse_targets(targets, self._referenced)
            self._refuse_if_unable(targets, reading)
            values = {name: self._axes[name].controller_value(target) for name, target in targets.items()}
            with self._expecting(values, reading):
                self._start_moves(values, reading, stops)
            for key in (ERROR, *targets):
                self._faults.pop(key, None)

    @abstractmethod
    def _host_mode(self) -> str:
        """Return the words that end echoes."""

    @abstractmethod
    def _abort(self) -> bytes:
        """Return the words that stop all axes."""

    @abstractmethod
    def _identify(self) -> None:
        """Raise a HardwareError unless the controller is the one that was meant."""

    @abstractmethod
    def _set_up(self, stops: int) -> None:
        """Write what is lost without power, and read it back if that can be done."""

    @abstractmethod
    def _has_lost_power(self) -> bool:
        """Whether what was written, or found, is there no more."""

    @abstractmethod
    def _read(self) -> Reading:
        """Ask for status first and then for positions: what moves no more has the position that it will keep."""

    @abstractmethod
    def _take_error(self) -> int:
        """Ask for the last error of all axes."""

    @abstractmethod
    def _start_moves(self, values: Mapping[str, str], reading: Reading, stops: int) -> None:
        """Begin to move axes to what the controller counts."""

    @abstractmethod
    def _start_homing(self, axes: list[str], stops: int) -> list[str]:
        """Begin to look for switches, of as many of some axes as can be at the same time; return which."""

    @abstractmethod
    def _fault_of_origin(self, name: str) -> str | None:
        """Return what is wrong with an axis that rests where its switch should be."""

    def _enter_host_mode(self, stops: int) -> None:
        """End echoes, and what was begun before."""
        self.link.send(f"{self.words_end.decode()}{self._host_mode()}", stops=stops)
        self.link.distrust()  # until then it may have echoed
        self._take_error()

    def _order(self, words: str, stops: int) -> None:
        """Give an order, and see whether it was refused."""
        self.link.send(words, stops=stops)
        if code := self._take_error():
            raise RefusedError(
                self.name, f"{words!r} was refused: {told(code)}", "see to its limits, and look at the state"
            )

    def _integers(self, words: str) -> list[int]:
        return self._as_integers(self.link.ask(words), words)

    def _integer(self, words: str) -> int:
        return self._as_integer(self.link.ask(words), words)

    def _numbers(self, words: str, count: int | None = None) -> list[float]:
        return self._as_numbers(self.link.ask(words), words, count)

    def _as_integers(self, reply: str, words: str) -> list[int]:
        try:
            return [int(number) for number in reply.split()]
        except ValueError:
            raise self._makes_no_sense(reply, words) from None

    def _as_integer(self, reply: str, words: str) -> int:
        numbers = self._as_integers(reply, words)
        if len(numbers) != 1:
            raise self._makes_no_sense(reply, words)
        return numbers[0]

    def _as_numbers(self, reply: str, words: str, count: int | None = None) -> list[float]:
        try:
            numbers = [float(number) for number in reply.split()]
        except ValueError:
            raise self._makes_no_sense(reply, words) from None
        if not numbers or count not in (None, len(numbers)) or not all(map(math.isfinite, numbers)):
            raise self._makes_no_sense(reply, words)
        return numbers

    def _makes_no_sense(self, reply: str, words: str) -> ReplyError:
        self.link.distrust()
        return ReplyError(
            self.name, f"{reply!r} is no answer to {words!r}", "see to cable and baud rate, or connect again"
        )

    def _written(self, words: str, query: str, value: float, stops: int) -> None:
        """Write a number and read it back."""
        self._order(f"{value:.7g} {words}", stops)
        there = self._numbers(query, 1)[0]
        if not math.isclose(there, value, rel_tol=0.01):
            raise HardwareError(
                self.name, f"{words} set to {value:.7g} leaves {there:g}", "see what the controller allows"
            )

    def _refuse_if_unable(self, axes: Collection[str], reading: Reading) -> None:
        """Refuse motions that would wait behind others, and those of axes that cannot move."""
        busy = [name for name in self.axes if name in self._sent and (name in axes or not self.begins_while_moving)]
        if busy or self._to_home:
            raise RefusedError(
                self.name, f"axis {', '.join(busy or self._to_home)} moves", "wait until it rests, or stop it"
            )
        for name in axes:
            if name in reading.faults:
                raise RefusedError(self.name, reading.faults[name], "see to that first")

    def _notice_stops(self) -> None:
        """After a stop nobody knows where axes come to rest, and no switch is looked for any more."""
        if self.link.stops != self._stops:
            self._stops = self.link.stops
            self._rests_at.clear()
            self._homing.clear()
            self._to_home.clear()

    def _observe(self) -> Reading:
        try:
            reading = self._read()
        except ReplyTimeoutError:
            if not self.tells_origins:
                self._account_for_silence()
            raise
        self._see_errors(reading)
        self._notice_stops()  # after it was read: what a stop has halted must not pass for an axis at its switch
        if reading.time_ns - self._answered_ns > RESTART_NS and self._has_lost_power():
            self._referenced.clear()
            self._homing.clear()
            self._to_home.clear()
            self._rests_at.clear()
            self._restarted = True
            self._faults[RESTART] = "it has been switched off and on: home its axes"
        self._answered_ns = reading.time_ns
        for name in self.axes:
            if name in reading.moving:
                self._sent.add(name)
            elif name in self._homing:
                self._account_for_origin(name, reading)
            else:
                self._account_for_rest(name, reading)
        return reading

    def _just_seen_at_rest(self) -> Reading | None:
        """Return what was read last, if that is as good as asking again: a loop asks, thinks a little, and sends."""
        reading = self._at_rest
        if reading is None or self.link.stops != self._stops:
            return None
        return reading if time.monotonic_ns() - reading.time_ns < FRESH_NS else None

    def _account_for_silence(self) -> None:
        """Believe no position that a restart would leave as well: it leaves 0."""
        for name, axis in self._axes.items():
            at_origin = axis.is_near(self._rests_at.get(name, axis.origin), axis.origin)
            if name in self._homing or (name in self._referenced and at_origin):
                self._faults[name] = f"axis {name} may have lost its power while no reply came: home it"
                self._referenced.discard(name)
        self._homing.clear()
        self._to_home.clear()

    def _see_errors(self, reading: Reading) -> None:
        """After a motion or a stop take its error, which would pass for that of the next order."""
        is_stopped = self.link.stops != self._stops
        if not is_stopped and self._sent <= set(reading.moving):
            return
        code = self._take_error()
        if code and not is_stopped:
            self._faults[ERROR] = told(code)

    def _account_for_origin(self, name: str, reading: Reading) -> None:
        axis, position = self._axes[name], reading.positions[name]
        if not axis.is_near(position, axis.origin) or name in reading.faults:
            fault: str | None = f"axis {name} has not found its switch: home it again"
        else:
            fault = self._fault_of_origin(name)
        self._homing.discard(name)
        self._sent.discard(name)
        self._rests_at[name] = position
        if fault:
            self._faults[name] = fault
        else:
            self._referenced.add(name)

    def _account_for_rest(self, name: str, reading: Reading) -> None:
        axis, position = self._axes[name], reading.positions[name]
        if not axis.is_near(position, self._rests_at.setdefault(name, position)):
            self._rests_at[name] = position
            if name in self._sent and (name in reading.at_lower or name in reading.at_upper):
                self._faults[name] = f"axis {name} ran onto a limit switch: move it back"
            else:
                self._referenced.discard(name)
                self._faults[name] = (
                    f"axis {name} rests at {position:g} {axis.axis.unit} and was not sent there: it met something, "
                    "was moved by other hands, or lost its power; home it"
                )
        self._sent.discard(name)

    def _axis_state(self, name: str, reading: Reading) -> AxisState:
        return AxisState(
            reading.positions[name],
            moving=name in self._sent or name in self._to_home,
            referenced=name in self._referenced,
            at_lower_limit=name in reading.at_lower,
            at_upper_limit=name in reading.at_upper,
        )

    def _home_next(self) -> None:
        waiting, self._to_home = self._to_home, []
        self._referenced.difference_update(waiting)
        for name in waiting:  # before, as nobody knows what becomes of an order that fails
            self._rests_at.pop(name, None)
            self._direction[name] = -1
        begun = self._start_homing(waiting, self._home_stops)
        self._homing.update(begun)
        self._sent.update(begun)
        self._to_home = [name for name in waiting if name not in begun]

    @contextmanager
    def _expecting(self, values: Mapping[str, str], reading: Reading) -> Iterator[None]:
        """Expect axes to come to rest at values, unless the controller refuses, or nobody knows what it does."""
        for name, value in values.items():
            target = self._axes[name].position(float(value))
            self._direction[name] = 1 if target >= reading.positions[name] else -1
            self._rests_at[name] = target
            self._sent.add(name)
        try:
            yield
        except BaseException:
            for name in values:
                self._rests_at.pop(name, None)
            raise


class Venus1Stage(VenusStage):
    """A Corvus: axes begin together, and none while another one moves.

    Speed and acceleration are common to all axes, so the slowest axis sets them. ``identity`` is what `identify` must
    contain. The number of axes that the controller is set to is taken from its positions.
    """

    begins_while_moving = False

    def __init__(
        self,
        name: str,
        url: str,
        axes: Mapping[str, VenusAxis],
        *,
        baud: int = 57600,
        timeout_s: float = 0.5,
        identity: str = "Corvus",
    ) -> None:
        """Name the line as for a SerialLink, and the axes; a ValueError for one that does not fit."""
        super().__init__(name, url, axes, baud=baud, timeout_s=timeout_s)
        self.identity = identity

    def _forget(self) -> None:
        super()._forget()
        self._switches: dict[str, tuple[bool, bool]] = {}  # as they were when the axis came to rest
        self._velocity = 0.0
        self._dimensions, self._here = 0, list[float]()

    def _host_mode(self) -> str:
        return "0 mode"

    def _abort(self) -> bytes:
        return b"abort"

    def _identify(self) -> None:
        identity = self.link.ask("identify")
        if self.identity not in identity:
            raise HardwareError(
                self.name, f"it says {identity!r}, where {self.identity!r} is missing", "see which port it is on"
            )
        self._dimensions = len(self._numbers("pos"))
        for name, axis in self._axes.items():
            if axis.number > self._dimensions:
                raise HardwareError(
                    self.name,
                    f"axis {name} is number {axis.number}, and it is set to {self._dimensions} axes",
                    "see to the numbers, or to setdim of the controller",
                )

    def _set_up(self, stops: int) -> None:
        self._order("0 joystick", stops)
        if self._integer("getjoystick") != 0:
            raise HardwareError(self.name, "its joystick stays on", "switch it off")
        for axis in self._axes.values():
            self._order(f"{MM} {axis.number} setunit", stops)
        units = self._integers("-1 getunit")
        if len(units) != 4 or any(units[axis.number - 1] != MM for axis in self._axes.values()):
            raise HardwareError(
                self.name,
                f"its units are {units} after they were set to {MM}, which is mm",
                "see what the controller allows",
            )
        if units[3] not in LENGTHS_MM:
            raise HardwareError(self.name, f"its velocity has the unit {units[3]}", "set it to a length, such as mm")
        scale = UNITS_PER_CONTROLLER_UNIT * LENGTHS_MM[units[3]]
        self._velocity = min(axis.speed for axis in self.axes.values()) / scale
        self._written("setvel", "getvel", self._velocity, stops)
        self._written("setaccel", "getaccel", min(axis.acceleration for axis in self.axes.values()) / scale, stops)

    def _has_lost_power(self) -> bool:
        return not math.isclose(self._numbers("getvel", 1)[0], self._velocity, rel_tol=0.01) or any(
            not self._has_calibrated(name) for name in self._referenced
        )

    def _has_calibrated(self, name: str) -> bool:
        return bool(self._integer(f"{self._axes[name].number} getcaldone") & 1)

    def _read(self) -> Reading:
        if self.link.is_behind and self.identity not in (reply := self.link.ask("identify")):
            raise self._makes_no_sense(reply, "identify")  # whose answer is like no other: a late one is known by it
        (status,), (places,) = self.link.ask_all(b"st p" + self.words_end, 2)  # at once, as each costs a while
        moves = bool(self._as_integer(status, "st") & 1)
        positions = self._here = self._as_numbers(places, "p", self._dimensions)
        time_ns = time.monotonic_ns()
        if moves:
            self._switches.clear()
            moving = self._sent or set(self.axes)
        else:
            moving = set()
            for name in self.axes:
                if name not in self._switches:  # which must not be asked for on the way
                    self._switches[name] = self._switches_at_rest(name, positions)
        return Reading(
            time_ns,
            {name: axis.position(positions[axis.number - 1]) for name, axis in self._axes.items()},
            set(moving),
            [name for name, (lower, _) in self._switches.items() if lower],
            [name for name, (_, upper) in self._switches.items() if upper],
        )

    def _switches_at_rest(self, name: str, positions: Sequence[float]) -> tuple[bool, bool]:
        """Ask for the switches, unless the axis came to where it was sent: there are none, and a period is short."""
        axis, target = self._axes[name], self._rests_at.get(name)
        is_there = target is not None and axis.is_near(axis.position(positions[axis.number - 1]), target)
        if is_there and name in self._sent and name not in self._homing:
            return False, False
        return self._switch_states(name)

    def _switch_states(self, name: str) -> tuple[bool, bool]:
        words = f"{self._axes[name].number} getswst"
        states = self._integers(words)
        if len(states) != 2:
            raise self._makes_no_sense(" ".join(map(str, states)), words)
        return states[0] != 0, states[1] != 0

    def _take_error(self) -> int:
        return self._integer("ge")

    def _start_moves(self, values: Mapping[str, str], reading: Reading, stops: int) -> None:
        """Move one axis by itself, or more of them together with the others, which are sent to where they are."""
        self._switches.clear()
        by_number = {self._axes[name].number: value for name, value in values.items()}
        if len(by_number) == 1:
            number, value = next(iter(by_number.items()))
            self._order(f"{value} {number} nmove", stops)
            return
        if len(by_number) < self._dimensions:
            here = enumerate(self._here, start=1)
            by_number = {number: by_number.get(number, f"{place:.6f}") for number, place in here}
        self._order(" ".join([*(by_number[number] for number in sorted(by_number)), "move"]), stops)

    def _start_homing(self, axes: list[str], stops: int) -> list[str]:
        """Look for all switches at once if there are no other axes, or for the first."""
        self._switches.clear()
        if len(axes) == self._dimensions > 1:
            self._order("cal", stops)
            return axes
        self._order(f"{self._axes[axes[0]].number} ncal", stops)
        return axes[:1]

    def _fault_of_origin(self, name: str) -> str | None:
        if not self._has_calibrated(name):
            return f"axis {name} has not found its switch: home it again"
        venus_axis = self._axes[name]
        axis = venus_axis.axis
        lower, upper = map(venus_axis.position, self._numbers(f"{venus_axis.number} getnlimit", 2))
        if axis.lo < lower - axis.resolution / 2 or axis.hi > upper + axis.resolution / 2:
            return (
                f"the limits of axis {name}, {axis.lo:g}..{axis.hi:g} {axis.unit}, are wider than the controller's, "
                f"{lower:g}..{upper:g}: narrow them, or let the controller measure its range"
            )
        return None


class Venus2Stage(VenusStage):
    """A Pollux, or several in a chain: each axis by itself, with a speed, an acceleration and limits of its own."""

    words_end = b" \r"
    tells_origins = False

    def __init__(
        self,
        name: str,
        url: str,
        axes: Mapping[str, VenusAxis],
        *,
        baud: int = 19200,
        timeout_s: float = 0.5,
    ) -> None:
        """Name the line as for a SerialLink, and the axes; a ValueError for one that does not fit."""
        super().__init__(name, url, axes, baud=baud, timeout_s=timeout_s)

    def _host_mode(self) -> str:
        return "0 nmode"

    def _abort(self) -> bytes:
        return " ".join(f"{axis.number} nabort" for axis in self._axes.values()).encode("ascii")

    def _identify(self) -> None:
        """There is no word for it: an axis that is not there does not answer."""

    def _set_up(self, stops: int) -> None:
        for axis in self._axes.values():
            number = axis.number
            self._written(f"{number} snv", f"{number} gnv", self._velocity(axis), stops)
            self._order(f"{axis.axis.acceleration / UNITS_PER_CONTROLLER_UNIT:.7g} {number} sna", stops)

    @staticmethod
    def _velocity(axis: VenusAxis) -> float:
        return axis.axis.speed / UNITS_PER_CONTROLLER_UNIT

    def _has_lost_power(self) -> bool:
        return any(
            not math.isclose(self._numbers(f"{axis.number} gnv", 1)[0], self._velocity(axis), rel_tol=0.01)
            for axis in self._axes.values()
        )

    def _read(self) -> Reading:
        statuses = {name: self._integer(f"{axis.number} nst") for name, axis in self._axes.items()}
        positions = {name: axis.position(self._numbers(f"{axis.number} np", 1)[0]) for name, axis in self._axes.items()}
        limited = [name for name, status in statuses.items() if status & Bits.LIMITED]
        return Reading(
            time.monotonic_ns(),
            positions,
            [name for name, status in statuses.items() if status & Bits.EXECUTING],
            [name for name in limited if self._direction.get(name, 0) <= 0],  # which end is not told
            [name for name in limited if self._direction.get(name, 0) >= 0],
            {name: fault for name, status in statuses.items() if (fault := self._fault(name, status))},
        )

    @staticmethod
    def _fault(name: str, status: int) -> str | None:
        for bit, fault in (
            (Bits.MACHINE_ERROR, "reports an error of its machine"),
            (Bits.MOTOR_OFF, "has its motor off"),
            (Bits.MANUAL, "is under manual control"),
        ):
            if status & bit:
                return f"axis {name} {fault}"
        return None

    def _take_error(self) -> int:
        codes = [self._integer(f"{axis.number} gne") for axis in self._axes.values()]
        return next((code for code in codes if code), 0)

    def _start_moves(self, values: Mapping[str, str], reading: Reading, stops: int) -> None:
        self._order(" ".join(f"{value} {self._axes[name].number} nm" for name, value in values.items()), stops)

    def _start_homing(self, axes: list[str], stops: int) -> list[str]:
        self._order(" ".join(f"{self._axes[name].number} ncal" for name in axes), stops)
        return axes

    def _fault_of_origin(self, name: str) -> str | None:
        """Also write the limits, which count from the switch."""
        axis = self._axes[name]
        lower, upper = axis.controller_value(axis.axis.lo), axis.controller_value(axis.axis.hi)
        try:
            self._order(f"{lower} {upper} {axis.number} setnlimit", self.link.stops)
        except RefusedError as error:
            return error.fault
        return None
