"""What the drivers of SIGMA KOKI's controllers have in common: pulses, and whether a counter can still be believed.

These controllers do not tell whether an axis has found its origin, nor that they were switched off. So the driver keeps
account: it knows at which count each axis ought to rest, and an axis that rests elsewhere has lost its reference. Where
speeds can be read back, it does so whenever the controller has not answered for long enough to have been restarted;
this shows only if its power-on speeds are others. Where they cannot, a reply that was missed costs an axis its
reference if 0, which a restart leaves, is a count that it may have. Not tried on a device.
"""

import math
import re
import threading
import time
from abc import abstractmethod
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from typing import NamedTuple

from stage_hardware.errors import (
    HardwareError,
    InterruptedByStopError,
    LinkError,
    RefusedError,
    ReplyError,
    ReplyTimeoutError,
)
from stage_hardware.links.serial_link import SerialLink
from stage_hardware.stage import Axis, AxisState, Stage, StageState

RESTART_NS = 500_000_000
"""A controller that answered less than this ago has not been restarted meanwhile."""


@dataclass(frozen=True)
class SigmaKokiAxis:
    """An axis, the ``number`` of its connector (from 1), and its pulses per unit.

    ``pulses_per_unit`` is exact: for a full step of 4 um that is divided by 8, ``Fraction(8, 4)``. ``division`` is
    that 8: it is set and read back if it is given. ``start_speed`` (in units per second) is reached at once; by
    default, as the manufacturer has it, half the speed of the axis, or 15 000 pulses per second for more than 50 000.
    ``seeks_origin`` is the direction (1 or -1) in which a GSC-02 looks for it; others know it.
    """

    axis: Axis
    number: int
    pulses_per_unit: Fraction
    division: int | None = None
    start_speed: float | None = None
    seeks_origin: int = -1

    def __post_init__(self) -> None:
        """Refuse a scale that does not fit the axis."""
        if self.pulses_per_unit <= 0:
            raise ValueError(f"an axis has more than 0 pulses per unit, got {self.pulses_per_unit}")
        if not math.isclose(self.axis.resolution, 1 / self.pulses_per_unit, rel_tol=1e-9):
            raise ValueError(
                f"an axis of {self.pulses_per_unit} pulses per {self.axis.unit} has a resolution of "
                f"{float(1 / self.pulses_per_unit):g} {self.axis.unit}, got {self.axis.resolution:g}"
            )
        if self.seeks_origin not in (-1, 1):
            raise ValueError(f"an origin is looked for in direction 1 or -1, got {self.seeks_origin}")

    def pulses(self, position: float) -> int:
        """Return the count that is nearest to a position."""
        return round(Fraction(position) * self.pulses_per_unit)

    def position(self, pulses: int) -> float:
        """Return the position of a count."""
        return float(pulses / self.pulses_per_unit)


@dataclass(frozen=True)
class SpeedRange:
    """What a controller lets one set: pulses per second from ``lo`` to ``hi`` in steps, and a ramp up to a second."""

    lo: int
    hi: int
    step: int = 1

    def speeds(self, name: str, axis: SigmaKokiAxis) -> "Speeds":
        """Return the speeds of an axis, never beyond what the axis bears; a ValueError if they are out of range."""
        fast = math.floor(Fraction(axis.axis.speed) * axis.pulses_per_unit / self.step) * self.step
        if axis.start_speed is None:
            wanted = fast // 2 if fast <= 50_000 else 15_000
        else:
            wanted = math.floor(Fraction(axis.start_speed) * axis.pulses_per_unit)
        start = max(self.lo, wanted // self.step * self.step)
        if not start <= fast <= self.hi:
            raise ValueError(
                f"axis {name} has a speed of {fast} and a start speed of {start} pulses per second; the controller "
                f"takes {self.lo}..{self.hi}, the latter not above the former"
            )
        ramp_ms = math.ceil(1000 * (fast - start) / (axis.axis.acceleration * axis.pulses_per_unit))
        if ramp_ms > 1000:
            raise ValueError(
                f"axis {name} takes {ramp_ms} ms from {start} to {fast} pulses per second, and the controller at most "
                f"1000: give it a higher acceleration or start speed, or a lower speed"
            )
        return Speeds(start, fast, ramp_ms)


class Speeds(NamedTuple):
    """A start speed and a largest one in pulses per second, and the time from one to the other in ms."""

    start: int
    fast: int
    ramp_ms: int


@dataclass(frozen=True)
class Reading:
    """What a controller says of all its axes, in their order, at ``time_ns`` of the monotonic clock."""

    time_ns: int
    counts: tuple[int, ...]
    busy: tuple[bool, ...]
    on_limit: tuple[bool, ...]
    refused: bool = False


class SigmaKokiStage(Stage):
    """A controller of SIGMA KOKI: what does not depend on the mode in which it is spoken to."""

    stop_replies = 1
    """How many lines answer a stop."""

    tells_settings = False
    """Whether what was written can be read back."""

    like_no_other: tuple[str, str]
    """A query, and the pattern of its answer, which cannot be that of any other command that is used."""

    def __init__(self, name: str, axes: Mapping[str, SigmaKokiAxis], link: SerialLink, connectors: int) -> None:
        """Take axes by name, each at a connector of its own."""
        numbers = [axis.number for axis in axes.values()]
        if not axes or len(set(numbers)) < len(numbers) or not all(1 <= number <= connectors for number in numbers):
            raise ValueError(f"axes have connectors of their own from 1 to {connectors}, got {numbers}")
        super().__init__(name, {key: axis.axis for key, axis in axes.items()})
        self.link, self.connectors, self._axes = link, connectors, dict(axes)
        self._turn = threading.Lock()  # of commands that take several transactions; a stop does not wait for it
        self._forget()

    def _forget(self) -> None:
        self._referenced: set[str] = set()
        self._homing: set[str] = set()
        self._to_home: list[str] = []
        self._sent: set[str] = set()  # whoever was set in motion and has not been seen at rest since
        self._rests_at: dict[str, int] = {}  # the count at which an axis is or will be at rest; absent if not known
        self._direction: dict[str, int] = {}
        self._counts: dict[str, int] = {}
        self._faults: dict[str, str] = {}  # by axis, or "" for the controller
        self._restarted = False
        self._answered_ns = 0
        self._in_step = True  # answers are those to the commands that they follow
        self._stops = self.link.stops

    def connect(self) -> None:
        """Open the link, see that the controller is the one that was meant, write speeds and read them back."""
        with self._turn:
            self.link.open()
            try:
                self._forget()
                self._identify()
                if any(self._read().busy):
                    raise HardwareError(self.name, "it moves already", "stop it, or wait, then connect again")
                self._set_up()
                self._answered_ns = time.monotonic_ns()
            except BaseException:
                self.link.close()
                raise

    def close(self) -> None:
        """Close the link; safe to call at any time, and twice."""
        self.link.close()

    def stop(self) -> None:
        """Stop all axes at once, without a ramp (`L:E`); motors keep their current."""
        self.link.urgent(b"L:E\r\n", is_answered=self.stop_replies > 0, lines=self.stop_replies)

    def state(self) -> StageState:
        """Ask where all axes are; also goes on to the next origin that :meth:`home` was to look for."""
        with self._turn:
            reading = self._observe()
            if self._to_home and not self._sent:
                next_one = self._to_home[0]
                try:
                    self._home_next()
                except RefusedError as error:
                    self._faults[next_one] = error.fault
            states = {name: self._axis_state(name, reading) for name in self.axes}
            return StageState(reading.time_ns, states, "; ".join(self._faults.values()) or None)

    def home(self, axes: Collection[str]) -> None:
        """Begin to look for the origins of some axes; they are referenced when they move no more.

        What the controller cannot begin at the same time, it begins when :meth:`state` has found the axis before at
        its origin.
        """
        stops = self.link.stops
        with self._turn:
            self._refuse_unknown(axes)
            self._notice_stops()
            if not self._in_step:
                self._get_in_step()
            if self._restarted:
                self._set_up()
                self._restarted = False
            self._to_home, self._home_stops = [name for name in self.axes if name in axes], stops
            for name in ("", *self._to_home):
                self._faults.pop(name, None)
            if self._to_home:
                self._home_next()

    def move_to(self, targets: Mapping[str, float]) -> None:
        """Begin to move some axes to absolute positions, in their units; they arrive at the nearest pulse."""
        stops = self.link.stops
        with self._turn:
            self._refuse_targets(targets, self._referenced)
            if not targets:
                return
            self._notice_stops()
            is_old = not self._in_step or time.monotonic_ns() - self._answered_ns > RESTART_NS
            if is_old or self._must_look_before_it_moves(targets):
                self._observe()
                self._refuse_targets(targets, self._referenced)
            counts = {name: self._axes[name].pulses(target) for name, target in targets.items()}
            for name, count in counts.items():
                self._direction[name] = 1 if count >= self._counts[name] else -1
            with self._expecting(counts):
                self._start_moves(counts, stops)
            for name in counts:
                self._faults.pop(name, None)

    def energise(self, on: bool) -> None:
        """Give current to all motors, or take it from them; then axes can be moved by hand, and must be homed again."""
        with self._turn:
            if not on:
                self._referenced.clear()
            self._order(self._energise_command(on), self.link.stops)

    @abstractmethod
    def _identify(self) -> None:
        """Raise a HardwareError unless the controller is the one that was meant."""

    @abstractmethod
    def _set_up(self) -> None:
        """Write what is lost without power, and read it back if that can be done."""

    @abstractmethod
    def _has_lost_settings(self) -> bool:
        """Whether what was written is there no more; asked only if the controller tells its settings."""

    @abstractmethod
    def _read(self) -> Reading:
        """Ask for counts and flags."""

    @abstractmethod
    def _start_moves(self, counts: Mapping[str, int], stops: int) -> None:
        """Begin to move axes to counts."""

    @abstractmethod
    def _start_homing(self, axes: list[str], stops: int) -> list[str]:
        """Begin to look for origins, of as many of some axes as can be at the same time; return which."""

    @abstractmethod
    def _energise_command(self, on: bool) -> str:
        """Return what switches the current of all motors."""

    def _must_look_before_it_moves(self, targets: Mapping[str, float]) -> bool:
        """Whether a move needs to know where axes are now."""
        return False

    def _ask(self, command: str, stops: int | None = None) -> str:
        try:
            return self.link.ask(command, stops=stops)
        except ReplyTimeoutError:
            self._in_step = False
            raise

    def _get_in_step(self) -> None:
        """Ask what no other answer fits: one that comes later than the link waits for it would be taken for another."""
        query, pattern = self.like_no_other
        reply = self._ask(query)
        if re.fullmatch(pattern, reply) is None:
            raise self._makes_no_sense(reply, query)
        self._in_step = True

    def _order(self, command: str, stops: int) -> None:
        """Give a command that is answered by OK or NG."""
        reply = self._ask(command, stops)
        if reply == "NG":
            raise self._refused(command)
        if reply != "OK":
            raise self._makes_no_sense(reply, command)

    def _refused(self, command: str) -> RefusedError:
        return RefusedError(
            self.name,
            f"{command!r} was refused",
            "see that it is at rest, that motors have current, and that the range fits",
        )

    def _makes_no_sense(self, reply: str, command: str) -> ReplyError:
        self.link.distrust()
        self._in_step = False
        return ReplyError(
            self.name,
            f"{reply!r} is no answer to {command!r}",
            "see to cable, baud rate and mode, and look at the state before the next command",
        )

    def _integers(self, fields: list[str], reply: str, command: str) -> tuple[int, ...]:
        try:
            return tuple(int(field.replace(" ", "")) for field in fields)
        except ValueError:
            raise self._makes_no_sense(reply, command) from None

    def _notice_stops(self) -> None:
        """After a stop nobody knows where axes come to rest, and no origin is looked for any more."""
        if self.link.stops != self._stops:
            self._stops = self.link.stops
            self._rests_at.clear()
            self._homing.clear()
            self._to_home.clear()

    def _observe(self) -> Reading:
        self._notice_stops()
        try:
            if not self._in_step:
                self._get_in_step()
            reading = self._read()
        except ReplyTimeoutError:
            if not self.tells_settings:
                self._account_for_silence()
            raise
        # At an origin a counter is 0, as it is after a restart, which could be taken for it however quick it was.
        has_homed = any(not reading.busy[self._axes[name].number - 1] for name in self._homing)
        might_be_restarted = has_homed or reading.time_ns - self._answered_ns > RESTART_NS
        if self.tells_settings and might_be_restarted and self._has_lost_settings():
            self._referenced.clear()
            self._homing.clear()
            self._to_home.clear()
            self._rests_at.clear()
            self._restarted = True
            self._faults[""] = "it has been switched off and on: home its axes"
        self._answered_ns, self._reading = reading.time_ns, reading
        for name, axis in self._axes.items():
            self._counts[name] = reading.counts[axis.number - 1]
            if not reading.busy[axis.number - 1]:
                self._account_for_rest(name, self._counts[name], reading.on_limit[axis.number - 1])
        return reading

    def _account_for_silence(self) -> None:
        """Believe no count that a restart would leave as well."""
        for name in self._referenced | self._homing:
            if name in self._homing or self._rests_at.get(name, 0) == 0:
                self._faults[name] = f"axis {name} may have lost its power while no reply came: home it"
                self._referenced.discard(name)
        self._homing.clear()
        self._to_home.clear()

    def _account_for_rest(self, name: str, count: int, on_limit: bool) -> None:
        if name in self._homing:
            self._homing.discard(name)
            if count == 0 and not on_limit:
                self._referenced.add(name)
            else:
                self._faults[name] = f"axis {name} has not found its origin: home it again"
        elif on_limit and name in self._sent:
            self._faults[name] = f"axis {name} ran onto a limit switch: move it back"
        elif self._rests_at.get(name, count) != count:
            self._referenced.discard(name)
            self._faults[name] = (
                f"axis {name} rests at {self._axes[name].position(count):g} {self.axes[name].unit} and was not sent "
                "there: it met something, was moved by other hands, or lost its power; home it"
            )
        self._sent.discard(name)
        self._rests_at[name] = count

    def _axis_state(self, name: str, reading: Reading) -> AxisState:
        index = self._axes[name].number - 1
        on_limit, direction = reading.on_limit[index], self._direction.get(name, 0)
        return AxisState(
            self._axes[name].position(reading.counts[index]),
            moving=reading.busy[index] or name in self._sent or name in self._to_home,
            referenced=name in self._referenced,
            at_lower_limit=on_limit and direction <= 0,  # which of the two switches is not told
            at_upper_limit=on_limit and direction >= 0,
        )

    def _home_next(self) -> None:
        waiting, self._to_home = self._to_home, []
        try:
            begun = self._start_homing(waiting, self._home_stops)
        except RefusedError:
            raise
        except HardwareError:  # it may have begun
            self._referenced.difference_update(waiting)
            raise
        self._referenced.difference_update(begun)
        for name in begun:
            self._direction.pop(name, None)
            self._rests_at.pop(name, None)
        self._homing.update(begun)
        self._sent.update(begun)
        self._to_home = [name for name in waiting if name not in begun]

    @contextmanager
    def _expecting(self, counts: Mapping[str, int]) -> Iterator[None]:
        """Expect axes to come to rest at counts, unless the controller refuses, or nobody knows what it does."""
        rested = {name: self._rests_at[name] for name in counts if name in self._rests_at}
        self._rests_at.update(counts)
        sent, self._sent = self._sent, self._sent | set(counts)
        try:
            yield
        except RefusedError:
            for name in counts:
                self._rests_at.pop(name)
            self._rests_at.update(rested)
            self._sent = sent
            raise
        except (InterruptedByStopError, LinkError, ReplyError, ReplyTimeoutError):
            for name in counts:
                self._rests_at.pop(name)
            self._answered_ns = min(self._answered_ns, time.monotonic_ns() - RESTART_NS - 1)  # look first, next time
            raise
