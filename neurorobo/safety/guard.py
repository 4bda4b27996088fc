"""Guards: each watches one thing, and says at once if it is not as it has to be."""

import math
from dataclasses import dataclass
from typing import Literal

from neurorobo.safety.limits import Limits

Reaction = Literal["stop", "retract", "latch"]
"""What a trip asks for: a stop; a stop and a way back while the load falls; a stop that has to be reset by hand."""


@dataclass(frozen=True)
class Trip:
    """Why a body is stopped: what trips, what is wrong, and what to do about it."""

    place: str
    fault: str
    cure: str
    reaction: Reaction = "stop"

    def __str__(self) -> str:
        """Return all of it in a line."""
        return f"{self.place}: {self.fault}; {self.cure}"


@dataclass(frozen=True)
class Reading:
    """What a sensor reported at ``time_ns`` of the clock of its body: components in the sensor's unit.

    ``sequence`` grows from reading to reading, where a sensor counts them. A reading that is not valid has a ``fault``.
    """

    time_ns: int
    values: tuple[float, ...]
    sequence: int | None = None
    fault: str | None = None


class SensorGuard:
    """Watches the readings of one sensor against its limits; see :class:`neurorobo.safety.limits.SensorLimits`.

    A load is the Euclidean norm of a reading's components; its rate is the change from a reading to one that is
    ``rate_window_ns`` older at least, divided by the time between, so that noise of single readings is no rate.
    """

    def __init__(self, name: str, unit: str, limits: Limits) -> None:
        """Watch the sensor ``name``, whose readings and ``limits`` are in ``unit``."""
        self.name, self.unit, self.limits = name, unit, limits
        self.reset()

    def reset(self) -> None:
        """Forget the readings so far: the next one is the first."""
        self._last: Reading | None = None
        self._since: tuple[int, float] | None = None  # the time and the load that the rate counts from

    def check(self, reading: Reading) -> Trip | None:
        """Return what is wrong with the next reading, if anything; the worst comes first."""
        last, self._last = self._last, reading
        if reading.fault is not None:
            return self._trip(reading.fault, "see to the sensor", "stop")
        if not all(map(math.isfinite, reading.values)):
            return self._trip(f"reports {reading.values}", "see to the sensor", "stop")
        if last is not None and last.sequence is not None and (reading.sequence or 0) <= last.sequence:
            fault = f"its readings count on from {last.sequence} to {reading.sequence}"
            return self._trip(fault, "it has stalled or was started anew: see to the sensor", "stop")
        return self._overload(reading)

    def check_age(self, now_ns: int) -> Trip | None:
        """Return what is wrong if the last reading is too old by now."""
        if self._last is None or self.limits.age_ns is None:
            return None
        age_ns = now_ns - self._last.time_ns
        if age_ns <= self.limits.age_ns:
            return None
        fault = f"its last reading is {age_ns / 1e6:.1f} ms old, of {self.limits.age_ns / 1e6:g} ms allowed"
        return self._trip(fault, "see to the sensor and its connection", "stop")

    def _overload(self, reading: Reading) -> Trip | None:
        load, limits = math.hypot(*reading.values), self.limits
        rate = self._rate(reading.time_ns, load)
        if limits.latch is not None and load > limits.latch:
            return self._trip(self._over(load, limits.latch, self.unit), "look at the rig before you reset it", "latch")
        if limits.stop is not None and load > limits.stop:
            return self._trip(self._over(load, limits.stop, self.unit), "find out what is in the way", "retract")
        if limits.rate is not None and rate > limits.rate:
            rises = f"rises by {self._over(rate, limits.rate, f'{self.unit}/s')}"
            return self._trip(rises, "find out what is in the way", "retract")
        return None

    def _rate(self, time_ns: int, load: float) -> float:
        """Return how fast the load rises, per second; 0 as long as that is not known."""
        if self._since is None:
            self._since = time_ns, load
            return 0.0
        before_ns, before = self._since
        if (passed_ns := time_ns - before_ns) < max(1, self.limits.rate_window_ns):
            return 0.0
        self._since = time_ns, load
        return (load - before) / (passed_ns * 1e-9)

    @staticmethod
    def _over(value: float, limit: float, unit: str) -> str:
        return f"{value:.4g} {unit}, of {limit:g} {unit} allowed"

    def _trip(self, fault: str, cure: str, reaction: Reaction) -> Trip:
        return Trip(self.name, fault, cure, reaction)
