"""Moves of a rig that is being commissioned: supervised, under a limit of the load, each agreed to by a person."""

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from types import TracebackType
from typing import Self

import numpy as np

from neurorobo.errors import NeuroroboError
from neurorobo.safety.limits import Limits
from neurorobo.safety.machine import SafetyError, SafetyMachine
from stage_hardware.force_sensor import ForceReading
from stage_hardware.rig.commissioning.dialogue import Dialogue
from stage_hardware.rig.commissioning.record import Commissioning, FreeRun, Response
from stage_hardware.rig.supervised_rig import ForceWatch, SupervisedRig

FOLLOWING_ERROR_UM = 5.0
RETRACTS_UM, RETRACTS_BY_UM = 200.0, 20.0
LONGEST_MOVE_UM = 150.0
"""The longest move on the way somewhere, between two looks at where the axes are."""

FEELS_S = 0.05
"""How long the force is averaged where an axis rests."""


@dataclass(frozen=True)
class Touch:
    """How contact is looked for: until the load is ``load_mN``, at most ``within_um`` from here, in small steps."""

    axis: str
    load_mN: float
    within_um: float
    step_um: float


class Moves:
    """A rig that moves, from ``with`` to its end, which stops it.

    ``limit_mN`` is the largest load, from that at the beginning; after a larger one, the way is gone back. Positions
    are in um and count from where episodes begin. All methods raise a SafetyError for whatever stops the rig.
    """

    def __init__(self, commissioning: Commissioning, dialogue: Dialogue, limit_mN: float) -> None:
        """Prepare it; nothing is connected yet, and a rig that is latched is refused when it is.

        Raises a NeuroroboError for a limit that the sensor cannot tell.
        """
        assert commissioning.record.check is not None
        rig, self._dialogue = commissioning.config.build(), dialogue
        self.axes = rig.axes
        self.forces = commissioning.forces
        largest_mN = min(one.largest for one in self.forces.values())
        if limit_mN >= largest_mN:
            raise NeuroroboError(
                f"a load of {limit_mN:g} mN would never be seen, as the sensor tells {largest_mN:g} mN at most; lower "
                "`--limit`"
            )
        age_ns = round(commissioning.record.check.oldest_ms * 1e6)
        self._machine = SafetyMachine(commissioning.latch)
        self._rig = SupervisedRig(
            rig,
            self._machine,
            [ForceWatch("load", tuple(self.forces), Limits(stop=limit_mN, age_ns=age_ns))],
            overrun="skip",
            following_error=max(FOLLOWING_ERROR_UM, *(10 * axis.resolution for axis in rig.axes.values())),
            retracts=RETRACTS_UM,
            retracts_by=RETRACTS_BY_UM,
            load=self._load_mN,
        )

    def __enter__(self) -> Self:
        """Arm, connect, and count loads from the present one."""
        self._machine.arm()
        self._rig.begin()
        try:
            self._rig.bias()
        except BaseException:
            self._rig.close()
            raise
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        """Stop, and let go; what the stop has to say is said, and does not hide why it came to it."""
        try:
            self._rig.close()
        except SafetyError as stopped:
            if error is None:
                raise
            self._dialogue.say(str(stopped))
        if kind is KeyboardInterrupt and (stands := self._rig.standstill()):
            self._dialogue.say(stands)

    def ask(self, question: str) -> None:
        """Rest, and raise a DeclinedError unless a person agrees to go on."""
        self._rig.halt()
        self._dialogue.require(question)
        self._rig.begin()

    def answer(self, question: str) -> str:
        """Rest until a person has answered."""
        self._rig.halt()
        answer = self._dialogue.answer(question)
        self._rig.begin()
        return answer

    def referenced(self) -> dict[str, bool]:
        """Return which axes know where they are."""
        return {axis: state.referenced for axis, state in self._rig.wait_until_at_rest(1.0).items()}

    def positions_um(self) -> dict[str, float]:
        """Return where the axes are."""
        return {axis: state.position for axis, state in self._rig.wait_until_at_rest(1.0).items()}

    def limits_um(self, axis: str) -> tuple[float, float]:
        """Return the ends of the travel of an axis."""
        return self._rig.rig.limits(axis)

    def home(self, axis: str) -> float:
        """Let an axis look for its origin, also if it knows where it is, and return how long that took (s)."""
        began_s = time.monotonic()
        self._rig.home([[axis]], again=True)
        return time.monotonic() - began_s

    def go_to(self, targets: Mapping[str, float], step_um: float = LONGEST_MOVE_UM) -> None:
        """Bring axes somewhere, in moves of ``step_um`` at most; after too large a load, they go back along them."""
        self._rig.go_on_to(targets, step_um)

    def go_to_start(self, last: str) -> None:
        """Bring all axes to where episodes begin, the one that may touch something when the others are there."""
        self.go_to({axis: 0.0 for axis in self.axes if axis != last})
        self.go_to({last: 0.0})

    def go_back_to(self, targets: Mapping[str, float]) -> None:
        """Bring axes out of contact; too large a load on the way only stops them."""
        self._rig.go_back_to(targets, LONGEST_MOVE_UM)

    def free_run(self, axis: str, target_um: float) -> FreeRun:
        """Move an axis there and back, and once more half of the way, where it is stopped; it comes back at the end."""
        start_um = self.positions_um()[axis]
        way_um = target_um - start_um
        there = self._rig.track({axis: target_um})
        back = self._rig.track({axis: start_um})
        off_um = max(abs(there[-1][1] - target_um), abs(back[-1][1] - start_um))
        speed_um_s = (_speed_um_s(there) + _speed_um_s(back)) / 2
        passed = self._rig.track({axis: target_um}, lambda position: abs(position - start_um) > abs(way_um) / 2)
        seen_ns, seen_um = passed[-1]
        stopped_ns = time.monotonic_ns()
        self._rig.halt()
        stood_ns = time.monotonic_ns()
        self._rig.begin()
        direction = 1.0 if way_um > 0 else -1.0
        was_um = seen_um + direction * speed_um_s * (stopped_ns - seen_ns) * 1e-9
        runs_on_um = max(0.0, direction * (self.positions_um()[axis] - was_um))
        self.go_to({axis: start_um}, abs(way_um))
        return FreeRun(
            speed_um_s=speed_um_s,
            off_um=off_um,
            runs_on_um=runs_on_um,
            stands_after_ms=(stood_ns - stopped_ns) / 1e6,
        )

    def touch(self, touch: Touch) -> float:
        """Move an axis in small steps until the load is as large, and return where.

        Raises a NeuroroboError if it never was, back where the axis was before, and if the load is as large before
        anything has moved: where it came from is not known.
        """
        axis = touch.axis
        if (load_now_mN := self.load_mN()) >= touch.load_mN:
            raise NeuroroboError(
                f"{axis}: the load is {load_now_mN:.3g} mN before it is moved, of {touch.load_mN:.4g} mN that count as "
                "contact; begin where nothing is touched (`start` in the rig file), or raise `--until`"
            )
        start_um, way_um = self.positions_um()[axis], 0.0
        while way_um < touch.within_um:
            way_um = min(way_um + touch.step_um, touch.within_um)
            self.go_to({axis: start_um + way_um}, touch.step_um)
            if self.load_mN() >= touch.load_mN:
                return self.positions_um()[axis]
        self.go_back_to({axis: start_um})
        raise NeuroroboError(
            f"{axis}: nothing was touched within {touch.within_um:g} um; let it look further (`--within`), or begin "
            "nearer (`start` in the rig file)"
        )

    def responses(self, axis: str, amplitude_um: float, times: int) -> dict[str, Response]:
        """Move an axis to and fro about where it is, and return how each component of the force follows it."""
        middle_um, ways_um, felt_mN = self.positions_um()[axis], list[float](), list[list[float]]()
        for way_um in [0.0, amplitude_um, 0.0, -amplitude_um] * times + [0.0]:
            self.go_to({axis: middle_um + way_um}, 2 * amplitude_um)
            ways_um.append(way_um)
            felt_mN.append(self._felt_mN())
        slopes, errors = _lines(np.array(ways_um), np.array(felt_mN))
        return {
            name: Response(
                component=name,
                stiffness_mN_um=slope,
                error_mN_um=error + component.resolution / (2 * amplitude_um),  # steps do not average out without noise
            )
            for (name, component), slope, error in zip(self.forces.items(), slopes, errors, strict=True)
        }

    def load_mN(self) -> float:
        """Return the load, averaged over a while."""
        return math.hypot(*self._felt_mN())

    def _felt_mN(self) -> list[float]:
        """Return the mean of each component of the force over :data:`FEELS_S`."""
        ends_s, readings = time.monotonic() + FEELS_S, dict[int, list[float]]()
        while time.monotonic() < ends_s or not readings:
            reading = self._rig.feel()
            readings[reading.sequence] = [reading.values[name] for name in self.forces]
            time.sleep(0.001)
        return [float(mean) for mean in np.mean(list(readings.values()), axis=0)]

    def _load_mN(self, reading: ForceReading) -> float:
        return math.hypot(*(reading.values[name] for name in self.forces))


def _speed_um_s(track: list[tuple[int, float]]) -> float:
    """Return the speed in the middle of a move, by a line through where the axis was seen; of few looks, on average."""
    times_s = np.array([time_ns for time_ns, _ in track]) * 1e-9
    ways_um = np.abs(np.array([position for _, position in track]) - track[0][1])
    middle = (ways_um > 0.15 * ways_um[-1]) & (ways_um < 0.85 * ways_um[-1])
    if middle.sum() >= 3:
        return float(np.polyfit(times_s[middle] - times_s[0], ways_um[middle], 1)[0])
    return float(ways_um[-1] / (times_s[-1] - times_s[0]))


def _lines(x: np.ndarray, y: np.ndarray) -> tuple[list[float], list[float]]:
    """Return slopes of columns ``y`` (n, m) over ``x`` (n,), and their standard errors, by least squares."""
    x, centred = x - x.mean(), y - y.mean(axis=0)
    slopes = x @ centred / (x @ x)
    residual = centred - np.outer(x, slopes)
    errors = np.sqrt((residual**2).sum(axis=0) / (len(x) - 2) / (x @ x))
    return slopes.tolist(), errors.tolist()
