"""An axis with a motor: where it is at any moment, as trapezoidal motion, limit switches and power have it."""

import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

Clock = Callable[[], float]
"""Seconds of a clock that never goes back."""


@dataclass(frozen=True)
class _Motion:
    """A motion from ``start`` over ``distance`` (signed) that began at ``began_s``: up to speed, on, and down again."""

    start: float
    distance: float
    began_s: float
    start_speed: float
    speed: float
    acceleration: float

    def phases(self) -> tuple[float, float, float]:
        """Return the duration of speeding up (or down), that of the speed reached, and that speed."""
        way = abs(self.distance)
        start_speed = min(self.start_speed, self.speed)
        ramp = (self.speed**2 - start_speed**2) / (2 * self.acceleration)
        reached = self.speed if 2 * ramp <= way else math.sqrt(start_speed**2 + self.acceleration * way)
        ramp_s = (reached - start_speed) / self.acceleration
        left = way - 2 * (reached**2 - start_speed**2) / (2 * self.acceleration)
        return ramp_s, max(0.0, left) / reached, reached

    def duration_s(self) -> float:
        """Return how long it takes."""
        ramp_s, on_s, _ = self.phases()
        return 2 * ramp_s + on_s

    def at(self, now_s: float) -> tuple[float, float]:
        """Return position and speed (signed)."""
        ramp_s, on_s, reached = self.phases()
        after = min(max(0.0, now_s - self.began_s), 2 * ramp_s + on_s)
        start_speed, sign = min(self.start_speed, self.speed), math.copysign(1.0, self.distance)
        if after >= 2 * ramp_s + on_s:
            return self.start + self.distance, 0.0
        if after < ramp_s:
            way, speed = start_speed * after + self.acceleration * after**2 / 2, start_speed + self.acceleration * after
        elif after < ramp_s + on_s:
            way = (start_speed + reached) / 2 * ramp_s + reached * (after - ramp_s)
            speed = reached
        else:
            left = 2 * ramp_s + on_s - after
            way = abs(self.distance) - start_speed * left - self.acceleration * left**2 / 2
            speed = start_speed + self.acceleration * left
        return self.start + sign * way, sign * speed


class Mechanism:
    """One axis of an emulated stage, in whatever unit its controller counts.

    Positions are physical, from ``lower_switch`` to ``upper_switch``, and the origin is at 0; ``counter`` is what the
    controller believes, which is lost with the power. Motions are computed, not stepped, so that a state is exact at
    any moment. ``slowness`` divides all speeds: a fault. All methods may be called from any thread.
    """

    def __init__(
        self,
        lower_switch: float,
        upper_switch: float,
        *,
        position: float = 0.0,
        start_speed: float,
        speed: float,
        acceleration: float,
        clock: Clock = time.monotonic,
    ) -> None:
        """Put the axis at a position, at rest and with its motor on."""
        self.lower_switch, self.upper_switch, self.clock = lower_switch, upper_switch, clock
        self.start_speed, self.speed, self.acceleration = start_speed, speed, acceleration
        self.motor_on, self.referenced, self.slowness = True, False, 1.0
        self.hit_limit = False
        self._lock = threading.RLock()
        self._offset = position  # the physical position at which the counter is 0
        self._motion = _Motion(position, 0.0, clock(), start_speed, speed, acceleration)
        self._homing = False

    @property
    def position(self) -> float:
        """Where it is."""
        with self._lock:
            return self._settle()[0]

    @property
    def velocity(self) -> float:
        """How fast it moves, signed."""
        with self._lock:
            return self._settle()[1]

    @property
    def counter(self) -> float:
        """Where the controller believes it is."""
        with self._lock:
            return self._settle()[0] - self._offset

    @property
    def zero(self) -> float:
        """The position at which the counter is 0."""
        with self._lock:
            self._settle()
            return self._offset

    @property
    def moving(self) -> bool:
        """Whether a motion is under way."""
        with self._lock:
            was_under_way = self._is_under_way()  # asked first: what has ended has then had its effect, too
            self._settle()
            return was_under_way and self._motion.distance != 0

    @property
    def destination(self) -> float:
        """Where it will come to rest if nobody stops it."""
        with self._lock:
            self._settle()
            return min(max(self._motion.start + self._motion.distance, self.lower_switch), self.upper_switch)

    @property
    def at_lower_switch(self) -> bool:
        """Whether it has run onto its lower switch."""
        return self.position <= self.lower_switch

    @property
    def at_upper_switch(self) -> bool:
        """Whether it has run onto its upper switch."""
        return self.position >= self.upper_switch

    def move_to(self, counter: float) -> None:
        """Begin to move to where the counter will be; a motor that is off does not."""
        with self._lock:
            self._begin(counter + self._offset)
            self._homing = False

    def move_by(self, distance: float) -> None:
        """Begin to move by a distance from here."""
        with self._lock:
            self._begin(self._settle()[0] + distance)
            self._homing = False

    def jog(self, direction: int) -> None:
        """Begin to move up (1) or down (-1) until stopped, or onto the switch."""
        self.move_by(direction * 10 * (self.upper_switch - self.lower_switch))

    def home(self) -> None:
        """Begin to move to the origin, where the counter becomes 0."""
        with self._lock:
            self._begin(0.0)
            self._homing = True

    def stop(self, *, hard: bool) -> None:
        """Stop at once, or as fast as the acceleration allows."""
        with self._lock:
            position, velocity = self._settle()
            self._homing = False
            way = 0.0 if hard else velocity * abs(velocity) / (2 * self.acceleration)
            if way == 0.0:
                self._rest_at(position)
            else:  # the second half of a motion twice as long
                self._motion = _Motion(
                    position - way,
                    2 * way,
                    self.clock() - abs(velocity) / self.acceleration,
                    0.0,
                    max(abs(velocity), 1e-12),
                    self.acceleration,
                )

    def set_counter(self, counter: float) -> None:
        """Let the counter have this value here."""
        with self._lock:
            self._offset = self._settle()[0] - counter

    def power_cycle(self) -> None:
        """Switch the controller off and on: the axis stands still, and its counter and its reference are lost."""
        with self._lock:
            position, _ = self._settle()
            self._rest_at(position)
            self._offset, self.referenced, self.motor_on, self._homing = position, False, True, False

    def _begin(self, target: float) -> None:
        position, _ = self._settle()
        self.hit_limit = False
        if not self.motor_on:
            self._rest_at(position)
            return
        self._motion = _Motion(
            position,
            target - position,
            self.clock(),
            self.start_speed / self.slowness,
            self.speed / self.slowness,
            self.acceleration / self.slowness,
        )

    def _rest_at(self, position: float) -> None:
        self._motion = _Motion(position, 0.0, self.clock(), self.start_speed, self.speed, self.acceleration)

    def _is_under_way(self) -> bool:
        return self._motion.distance != 0 and self.clock() < self._motion.began_s + self._motion.duration_s()

    def _settle(self) -> tuple[float, float]:
        """Return position and velocity now, after what a switch or the end of a motion does."""
        position, velocity = self._motion.at(self.clock()) if self._motion.distance else (self._motion.start, 0.0)
        if not self.lower_switch <= position <= self.upper_switch:
            position, velocity = min(max(position, self.lower_switch), self.upper_switch), 0.0
            self.hit_limit, self._homing = True, False
            self._rest_at(position)
        elif self._homing and not self._is_under_way():
            self._homing, self.referenced, self._offset = False, True, position
        return position, velocity
