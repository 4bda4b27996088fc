"""A rig under supervision: it moves only while nothing is wrong, keeps pace, and is stopped and drawn back."""

import math
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from typing import Any, TypeVar

from neurorobo.bodies.pacer import MissedDeadlineError, Overrun, Pacer
from neurorobo.errors import NeuroroboError
from neurorobo.safety.guard import Reading, SensorGuard, Trip
from neurorobo.safety.limits import Limits
from neurorobo.safety.machine import SafetyError, SafetyMachine, SafetyState
from neurorobo.safety.watch import SafetyWatch
from stage_hardware.errors import HardwareError, InterruptedByStopError
from stage_hardware.force_sensor import ForceReading
from stage_hardware.rig.rig import Rig
from stage_hardware.rig.undisturbed import undisturbed
from stage_hardware.stage import AxisState, Stage, StageState

Result = TypeVar("Result")
LOOP = "deadline"
"""What trips if the control loop is late."""

HOMES_AT_LEAST_AT = 0.2
"""How fast an axis looks for its origin at least, as a share of its speed: controllers have speeds of their own."""

TURNS_WITHIN_S = 10.0
"""What more it may take, to turn at switches and to begin one after the other."""

DRAWN_BACK_WITHIN_S = 2.0
"""How long a step of the way back may take."""

RISES_BY_SHARE, RISES_BY_STEPS = 0.02, 5.0
"""What of a rise of the load on the way back is none: this share of the least load so far, or these many steps of the
sensor, as a load that is gone leaves noise."""

GRACE_NS = 200_000_000
"""How much longer than a period a loop may say nothing before it is taken for dead."""


SETTLES_NS = 100_000_000
"""How much longer than a period an axis may settle that is where it was sent."""


class _Mover:
    """A stage, as the safety watch sees it."""

    def __init__(self, stage: Stage) -> None:
        self._stage = stage

    def stop(self) -> None:
        self._stage.stop()

    def is_moving(self) -> bool:
        return any(axis.moving for axis in self._stage.state().axes.values())


class ForceWatch:
    """Guards over components of a force sensor, asked with each of its readings, in its own thread.

    ``limits`` are those of the load that the components make together. What is to be latched is looked for in the
    readings from the device's own zero as well: a bias that was taken in contact hides a load.
    """

    def __init__(self, name: str, components: Sequence[str], limits: Limits) -> None:
        """Watch components of the sensor ``name``."""
        self._components = tuple(components)
        self._guard = SensorGuard(name, "mN", limits)
        self._absolute = SensorGuard(f"{name}, from the sensor's own zero,", "mN", Limits(latch=limits.latch))
        self._free = SensorGuard(f"{name} where nothing is touched", "mN", Limits())
        self._last_ns: int | None = None
        self._lock = threading.Lock()  # guards are for one thread, and are asked by several

    def free(self, limit_mN: float | None) -> None:
        """Let another limit hold as well where the load should be none, or no longer."""
        self._free.limits = Limits(stop=limit_mN)

    def expect(self, since_ns: int) -> None:
        """Expect readings from a time on: a sensor that never gives one grows old as well."""
        self._last_ns = since_ns
        self.forget()

    def forget(self) -> None:
        """Begin anew: after a bias, the load jumps. That the last reading grows old is not forgotten."""
        with self._lock:
            self._guard.reset()
            self._absolute.reset()
            if self._last_ns is not None:
                self._guard.check(Reading(self._last_ns, (), fault="none yet"))  # of which the age alone counts

    def check(self, reading: ForceReading) -> Trip | None:
        """Return what is wrong with a reading."""
        with self._lock:
            self._last_ns = reading.time_ns
            biased = tuple(reading.values[name] for name in self._components)
            found = self._guard.check(Reading(reading.time_ns, biased, reading.sequence, reading.fault))
            if found is None or found.reaction != "latch":
                unbiased = tuple(reading.unbiased[name] for name in self._components)
                found = self._absolute.check(Reading(reading.time_ns, unbiased)) or found
            return found or self._free.check(Reading(reading.time_ns, biased))

    def check_age(self, now_ns: int) -> Trip | None:
        """Return what is wrong if the last reading is too old."""
        with self._lock:
            return self._guard.check_age(now_ns)


class SupervisedRig:
    """Moves a rig on behalf of a control loop; see :class:`neurorobo.safety.machine.SafetyState` for what it may do.

    Whatever goes wrong stops all controllers at once, is verified, and ends in a SafetyError that says what it was.
    After too large a load, the rig is drawn back along the way it came by ``retracts`` um at most, in steps of
    ``retracts_by``, both of the axis that goes farthest, as long as the load falls. Commands are absolute, and none
    outlasts its period: a loop that dies leaves at most one of them under way.
    """

    def __init__(
        self,
        rig: Rig,
        machine: SafetyMachine,
        force_watches: Sequence[ForceWatch],
        *,
        overrun: Overrun,
        following_error: float,
        retracts: float,
        retracts_by: float,
        load: Callable[[ForceReading], float],
    ) -> None:
        """Prepare it; :meth:`begin` connects. ``load`` (mN) is what has to fall on the way back."""
        self.rig, self.machine, self.force_watches = rig, machine, tuple(force_watches)
        self.following_error, self._load = following_error, load
        self._retracts, self._retracts_by = retracts, retracts_by
        checks = [self._check_loop, self._check_age]
        self.watch = SafetyWatch(machine, {name: _Mover(stage) for name, stage in rig.stages.items()}, checks)
        self.pacer = Pacer(overrun, sleep=self._sleep)
        self.path: list[dict[str, float]] = []
        """Where the axes have been since they set out, and will be drawn back along; what is under way is not there."""
        self._sent_to: dict[str, float] = {}
        self._alive_until_ns: int | None = None
        self._asking_takes_ns: dict[str, int] = {}
        self._arrive_ns: dict[str, int] = {}  # by controller, when its axes should be where they were sent
        self._waited_for: str | None = None
        self._is_open = self._was_reported = False
        self._while_open = ExitStack()
        self._is_setting_out = False
        self._sent_ms: dict[str, float] = {}  # from the beginning of the last halt until each was sent its stop
        self._stood_ms: dict[str, float] = {}

    def begin(self) -> None:
        """Connect, if that was not done, and watch from now on; a SafetyError for a rig that may not move."""
        self._alive_until_ns = None  # no period is under way
        self._sent_ms, self._stood_ms = {}, {}
        if self.machine.state is not SafetyState.RUNNING:
            self.machine.run()
        if self._is_open:
            return
        self._while_open.enter_context(undisturbed())
        try:
            self.rig.connect()
            self._is_open = True
            for watch in self.force_watches:
                watch.expect(time.monotonic_ns())
            self.watch.start()
            self.rig.sensor.watch(self._felt)  # whose first reading may trip already
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Stop what moves, and let go of everything; safe to call twice."""
        try:
            self.halt()
        finally:
            if self._is_open:
                self._is_open = False
                self.watch.close()
                self.rig.close()
            self._while_open.close()
        self.machine.disarm()

    def halt(self) -> None:
        """Stop all axes, and see that they stand; a SafetyError if they do not, or were stopped and nobody told why."""
        self._alive_until_ns = None
        if self._is_open and self._tripped and not self._was_reported:
            raise self._stopped()
        if not self._is_open or self.machine.state is not SafetyState.RUNNING:
            return
        trips, sent_ms, began_ns = [], dict[str, float](), time.monotonic_ns()
        for name, stage in self.rig.stages.items():
            try:
                stage.stop()
                sent_ms[name] = (time.monotonic_ns() - began_ns) / 1e6
            except Exception as error:  # whatever fails, the others have to be stopped
                cure = "see to it before the next run"
                trips.append(_trip_of(error) if isinstance(error, HardwareError) else Trip(name, repr(error), cure))
        if trips:
            self.watch.trip(trips[0])
            raise self._stopped()
        self._sent_ms = sent_ms
        self._call(lambda: self.rig.wait_until_at_rest(2.0))
        self._stood_ms = dict.fromkeys(self.rig.stages, (time.monotonic_ns() - began_ns) / 1e6)
        self.machine.rest()

    def standstill(self) -> str:
        """Say that all axes stand since the last :meth:`halt`, and how soon they did; nothing if that is not known."""
        if not self._stood_ms:
            return ""
        sent_ms, stood_ms = max(self._sent_ms.values()), max(self._stood_ms.values())
        return f"all axes were sent a stop within {sent_ms:.0f} ms, and were seen to stand after {stood_ms:.0f} ms"

    def home(self, order: Sequence[Sequence[str]], *, again: bool = False) -> None:
        """Home the axes that do not know where they are, or with ``again`` all, group by group."""
        known = {name for name, state in self._call(self.rig.state).items() if state.referenced and not again}
        for group in order:
            if waiting := [axis for axis in group if axis not in known]:
                self._set_out(partial(self.rig.home, waiting))
                ways_s = sum((axis.hi - axis.lo) / axis.speed for axis in map(self.rig.axes.__getitem__, waiting))
                self.wait_until_at_rest(ways_s / HOMES_AT_LEAST_AT + TURNS_WITHIN_S)

    def go_to(self, targets: Mapping[str, float], step: float) -> None:
        """Bring some axes somewhere in moves of ``step`` at most, and wait until they are there: a new way begins."""
        self.path = []
        self.go_on_to(targets, step)
        del self.path[:-1]

    def go_on_to(self, targets: Mapping[str, float], step: float) -> None:
        """Bring some axes somewhere as :meth:`go_to` does, as a part of the way."""
        self.path = self.path or [self._targets(self._call(self.rig.state))]
        self._sent_to = {}
        for states in self._moves(targets, step):
            self.path.append(self._targets(states))

    def track(
        self, targets: Mapping[str, float], is_enough: Callable[[float], bool] = lambda _: False
    ) -> list[tuple[int, float]]:
        """Send one axis somewhere, and ask until it rests or ``is_enough`` of its position.

        Returns where it was, by its controller's account, and when, in ns of the monotonic clock.
        """
        ((axis, target),) = targets.items()
        stage, frame = self.rig.stages[self.rig.controller_of[axis]], self.rig.frames[axis]
        began = self._call(self.rig.state)[axis].position
        track = [(time.monotonic_ns(), began)]
        self.send(targets)
        ends = time.monotonic() + 2 * self.rig.axes[axis].moves_for_s(target - began) + 2.0
        while True:
            state = self._call(stage.state)
            if state.fault is not None:
                self.watch.trip(Trip(stage.name, state.fault, "see to it, then home its axes"))
            self._check()
            one = state.axes[axis]
            track.append((state.time_ns, frame.to_rig(one.position)))
            if not one.moving or is_enough(track[-1][1]):
                self.path.append({**self._sent_to, axis: track[-1][1]})
                return track
            if time.monotonic() > ends:
                self.watch.trip(Trip(stage.name, f"{axis} still moves after twice its time", "see what slows it down"))

    def _moves(self, targets: Mapping[str, float], step: float) -> Iterator[dict[str, AxisState]]:
        """Move some axes somewhere, ``step`` at most at a time; yields where they have come to."""
        if not targets:
            return
        here = {name: state.position for name, state in self._call(self.rig.state).items()}
        moves = max(1, *(math.ceil(abs(target - here[axis]) / step) for axis, target in targets.items()))
        for i in range(1, moves + 1):
            place = {
                axis: self._within(axis, here[axis] + (target - here[axis]) * i / moves)
                for axis, target in targets.items()
            }
            self._set_out(partial(self.rig.move_to, place))
            longest_s = max(abs(place[axis] - here[axis]) / self.rig.axes[axis].speed for axis in targets)
            states = self.wait_until_at_rest(2 * longest_s + 2.0)
            self._check_arrival(states, place)
            yield states

    def go_back_to(self, targets: Mapping[str, float], step: float) -> None:
        """Bring some axes out of contact as :meth:`go_to` does: too large a load on the way does not lead in again."""
        self.path = []
        for _ in self._moves(targets, step):
            pass

    def withdraw(self, step: float) -> None:
        """Go back along the way that the rig came, to where it set out, in moves of ``step`` or so."""
        way = self.path[-1:]
        for place in reversed(self.path[:-1]):
            if _farthest(place, way[-1]) >= step:
                way.append(place)
        way += self.path[:1]
        for place in way:
            self.go_back_to(place, step)

    def send(self, targets: Mapping[str, float]) -> None:
        """Send some axes somewhere; returns when the controllers have taken it."""
        self._set_out(partial(self.rig.move_to, targets))
        before = self.path[-1] if self.path else {}
        self._sent_to = {**before, **targets}
        sent_ns = time.monotonic_ns()
        self._arrive_ns = {}
        for axis, target in targets.items():
            way_ns = round(1e9 * self.rig.axes[axis].moves_for_s(target - before.get(axis, target)))
            controller = self.rig.controller_of[axis]
            self._arrive_ns[controller] = max(self._arrive_ns.get(controller, 0), sent_ns + way_ns)

    def start_pace(self) -> None:
        """Let the first period begin now."""
        self.pacer.start()

    def end_period(self, duration_ns: int) -> dict[str, AxisState]:
        """Wait until the period ends, see that all axes arrived before, and return how they are."""
        deadline_ns = self.pacer.deadline_ns(duration_ns)
        self._alive_until_ns = deadline_ns + duration_ns + GRACE_NS
        is_late = time.monotonic_ns() > deadline_ns
        if is_late:  # the loop is, so that axes cannot have arrived yet: they have another period
            self._end_pace(duration_ns)
            deadline_ns = time.monotonic_ns() + duration_ns
            self._alive_until_ns = deadline_ns + duration_ns + GRACE_NS
        states = self._ask(lambda controller: min(self._arrive_ns.get(controller, 0), deadline_ns))
        while self._is_time_to_ask(deadline_ns, states):
            states = self._ask()
        self._check_arrival(states, self._sent_to)
        self.path.append(self._targets(states))
        if not is_late:
            self._end_pace(duration_ns)
        return states

    def _end_pace(self, duration_ns: int) -> None:
        """Wait until the period ends; one that is over already may trip."""
        try:
            self.pacer.wait(duration_ns)
        except MissedDeadlineError as error:
            fault, cure = str(error).split("; ", 1)
            self.watch.trip(Trip(LOOP, fault, cure))
        self._check()

    def feel(self) -> ForceReading:
        """Return the last reading of the force, which can be trusted; the guards have seen it."""
        self._check()
        reading = self.rig.sensor.latest()
        if reading.fault is not None:
            self.watch.trip(Trip(self.rig.sensor.name, reading.fault, "see to the sensor"))
            self._check()
        return reading

    def bias(self) -> None:
        """Count forces from the present load."""
        self._call(self.rig.sensor.bias)
        for watch in self.force_watches:
            watch.forget()

    def timing(self) -> dict[str, Any]:
        """Return what became of the deadlines, and when the last stop was sent and seen to be obeyed, ready for JSON.

        Times of a stop are ms from the trip (``tripped_ns``), without one from the end of the episode or Ctrl-C.
        """
        has_tripped = self.watch.tripped_ns is not None
        return {
            "overruns": self.pacer.overruns,
            "late": [{"deadline_ns": due_ns, "late_ms": late_ns / 1e6} for due_ns, late_ns in self.pacer.late],
            "skipped": self.pacer.skipped,
            "readings_lost": self.rig.sensor.latest().lost,
            "tripped_ns": self.watch.tripped_ns,
            "stop_sent_after_ms": self.watch.reaction_ms if has_tripped else max(self._sent_ms.values(), default=None),
            "sent_ms": self.watch.sent_ms if has_tripped else self._sent_ms,
            "stood_ms": self.watch.stood_ms if has_tripped else self._stood_ms,
        }

    def wait_until_at_rest(self, within_s: float) -> dict[str, AxisState]:
        """Wait until nothing moves; a SafetyError if that takes longer, after a stop."""
        ends = time.monotonic() + within_s
        while True:
            states = self._ask()
            moving = [axis for axis, state in states.items() if state.moving]
            if not moving:
                self._check()  # what stands may have been stopped
                return states
            if time.monotonic() > ends:
                fault = f"{', '.join(moving)} still moves after {within_s:.1f} s"
                self.watch.trip(Trip(self.rig.controller_of[moving[0]], fault, "see what slows it down"))
            self._sleep(0.01)

    @property
    def may_move(self) -> bool:
        """Whether it is connected and nothing is wrong."""
        return self._is_open and self.machine.state in (SafetyState.ARMED, SafetyState.RUNNING)

    @property
    def _tripped(self) -> bool:
        return self.machine.trip is not None

    def _sleep(self, seconds: float) -> None:
        """Sleep, but no longer than until a trip, which it raises."""
        self.watch.sleep(seconds)
        self._check()

    def _felt(self, reading: ForceReading) -> None:
        """Take a reading, in the sensor's thread; once stopped, it can only get worse."""
        for watch in self.force_watches:
            trip = watch.check(reading)
            if trip is not None and (trip.reaction == "latch" or not self._tripped):
                self.watch.trip(trip)

    def _check_age(self, now_ns: int) -> Trip | None:
        """Return what is wrong with a sensor that has fallen silent, unless nothing moves anyhow."""
        if self.machine.state is not SafetyState.RUNNING:
            return None
        return next((trip for watch in self.force_watches if (trip := watch.check_age(now_ns))), None)

    def _check_loop(self, now_ns: int) -> Trip | None:
        until_ns = self._alive_until_ns
        if until_ns is None or now_ns <= until_ns:
            return None
        fault = f"the control loop has said nothing for {(now_ns - until_ns + GRACE_NS) / 1e9:.1f} s more than a period"
        return Trip(LOOP, fault, "choose a longer period, or see what holds it up")

    def _within(self, axis: str, position: float) -> float:
        """Return the nearest position that the axis may be sent to: its origin may be beyond its travel."""
        lo, hi = self.rig.limits(axis)
        return min(max(position, lo), hi)

    def _check_arrival(self, states: Mapping[str, AxisState], targets: Mapping[str, float]) -> None:
        """Trip if an axis is not where it was sent."""
        for axis, target in targets.items():
            state, unit = states[axis], self.rig.axes[axis].unit
            off = abs(state.position - target)
            if state.moving or off > self.following_error:
                what = "is still under way to" if state.moving else "was sent to"
                fault = f"axis {axis} {what} {target:g} {unit} and is at {state.position:g} {unit}"
                cure = (
                    f"see what slows or blocks it, or allow a larger `following_error` than {self.following_error:g} um"
                )
                self.watch.trip(Trip(self.rig.controller_of[axis], fault, cure))
        self._check()

    @staticmethod
    def _targets(states: Mapping[str, AxisState]) -> dict[str, float]:
        return {axis: state.position for axis, state in states.items()}

    def _is_time_to_ask(self, deadline_ns: int, states: Mapping[str, AxisState]) -> bool:
        """Whether to ask axes that move once more: before the deadline, or if they only settle where they were sent.

        Those make the period late, which is another fault than to be somewhere else.
        """
        moving = [axis for axis, state in states.items() if state.moving]
        off = (abs(states[axis].position - self._sent_to.get(axis, math.inf)) for axis in moving)
        late_ns = deadline_ns + SETTLES_NS if max(off, default=math.inf) <= self.following_error else deadline_ns
        longest_ns = max(self._asking_takes_ns.values(), default=0)
        return bool(moving) and time.monotonic_ns() + 3 * longest_ns // 2 < late_ns

    def _ask(self, not_before_ns: Callable[[str], int] = lambda _: 0) -> dict[str, AxisState]:
        """Ask all controllers how their axes are, each at its time, and note how long that takes."""

        def ask(controller: str) -> StageState:
            if (left_ns := not_before_ns(controller) - time.monotonic_ns()) > 0:
                self.watch.sleep(left_ns * 1e-9)  # a trip is told in the thread of the loop, which draws back
            began_ns = time.monotonic_ns()
            state = self.rig.stages[controller].state()
            # The longest of late: a controller may be asked for more when its axes have come to rest.
            took_ns, before_ns = time.monotonic_ns() - began_ns, self._asking_takes_ns.get(controller, 0)
            self._asking_takes_ns[controller] = max(took_ns, 19 * before_ns // 20)
            return state

        return self._call(partial(self.rig.state, ask))

    def _set_out(self, motion: Callable[[], None]) -> None:
        """Let axes begin to move; a stop that comes meanwhile may be overtaken by the command, and is sent again."""
        self._is_setting_out = True
        self._call(motion)
        self._check()
        self._is_setting_out = False

    def _call(self, ask: Callable[[], Result]) -> Result:
        """Ask a device; whatever it refuses stops all."""
        self._check()
        try:
            return ask()
        except InterruptedByStopError as error:
            self._waited_for = error.device
            self.watch.trip(_trip_of(error))
        except HardwareError as error:
            self.watch.trip(_trip_of(error))
        raise self._stopped()

    def _check(self) -> None:
        if self._tripped:
            raise self._stopped()
        self.machine.check()

    def _stopped(self) -> SafetyError:
        """See that all stand after a trip, draw back if that is asked for, and say what happened."""
        trip = self.machine.trip
        assert trip is not None
        if self._was_reported:
            return SafetyError(str(trip), trip)
        self._was_reported = True
        stand = self.watch.wait_until_all_stand()
        if stand and self._is_setting_out:
            stand = self.watch.stop_again()
        words = [str(trip)]
        if trip.place == LOOP and self._waited_for is not None:
            words.append(f"it was waiting for a reply of {self._waited_for}")
        if self.watch.faults:
            words.append(self._may_still_move())
        elif not stand:
            words.append("whether all axes stand is not known: cut their power")
        else:
            words.append("all axes were stopped and stand")
            if trip.reaction == "retract" and self.machine.state is not SafetyState.LATCHED:
                words.append(self._retract())
        if self.machine.state is SafetyState.LATCHED:
            latch = self.machine.latch
            words.append(latch.refusal() or latch.refusal_of(f"{trip.place}: {trip.fault}"))
        if self.machine.latch_fault is not None:
            words.append(f"the latch holds for this run only: {self.machine.latch_fault}")
        return SafetyError("\n".join(words), trip)

    def _retract(self) -> str:
        """Draw back along the path while the load falls, and say how that went."""
        rig = self.rig
        rises_by = RISES_BY_STEPS * max(one.resolution for one in rig.sensor.components.values() if one.unit == "mN")
        try:
            reached = here = self._targets(rig.state())
            load = least = before = self._load_to_trust()
            places = _back(here, self.path, self._retracts, self._retracts_by)
            if not places:
                return "not drawn back: no way is known that it came"
            for place in places:
                moved = {axis: position for axis, position in place.items() if position != reached[axis]}
                rig.move_to({axis: self._within(axis, position) for axis, position in moved.items()})
                if (fault := self._wait_while_drawn_back()) is not None:
                    return self._not_drawn_back(fault)
                reached, load = place, self._load_to_trust()
                if load > least + max(RISES_BY_SHARE * least, rises_by):
                    fault = f"on the way back the load rose from {least:.4g} to {load:.4g} mN"
                    self.machine.stop(Trip("retraction", fault, "look at the rig before you reset it", "latch"))
                    return self._not_drawn_back(fault)
                least = min(least, load)
        except NeuroroboError as error:
            return self._not_drawn_back(str(error))
        except BaseException:  # such as Ctrl-C: what has just set out is not left under way
            self.watch.stop_again()
            raise
        distance_um = _farthest(here, reached)
        return f"drawn back by {distance_um:.0f} um, the load went from {before:.4g} to {load:.4g} mN"

    def _load_to_trust(self) -> float:
        """Return the present load (mN); a HardwareError if the sensor does not tell it."""
        reading = self.rig.sensor.latest()
        load = self._load(reading)
        if reading.fault is not None or not math.isfinite(load):
            raise HardwareError(self.rig.sensor.name, reading.fault or f"reports {load} mN", "see to the sensor")
        return load

    def _wait_while_drawn_back(self) -> str | None:
        """Wait until nothing moves; return what is wrong, if something is."""
        ends = time.monotonic() + DRAWN_BACK_WITHIN_S
        while True:
            self._load_to_trust()
            if self.machine.state is SafetyState.LATCHED:
                return f"on the way back, {self.machine.latch.reason()}"
            moving = [axis for axis, state in self.rig.state().items() if state.moving]
            if not moving:
                return None
            if time.monotonic() > ends:
                controller = self.rig.controller_of[moving[0]]
                return f"{controller}: {', '.join(moving)} still moves after {DRAWN_BACK_WITHIN_S:g} s"
            time.sleep(0.005)

    def _not_drawn_back(self, fault: str) -> str:
        """Stop once more, as a way back that is given up may be under way still."""
        words = f"not drawn back any further: {fault}"
        if self.watch.stop_again():
            return words
        return f"{words}\n{self._may_still_move()}"

    def _may_still_move(self) -> str:
        told = "; ".join(f"{name}: {fault}" for name, fault in self.watch.faults.items())
        return f"it may still move, cut its power: {told or 'whether all axes stand is not known'}"


def _trip_of(error: HardwareError) -> Trip:
    return Trip(error.device, error.fault, error.cure)


def _farthest(place: Mapping[str, float], other: Mapping[str, float]) -> float:
    """Return how far that axis goes which goes farthest from one place to another."""
    return max((abs(other[axis] - place[axis]) for axis in place.keys() & other.keys()), default=0.0)


def _back(
    here: Mapping[str, float], path: Sequence[Mapping[str, float]], distance: float, step: float
) -> list[dict[str, float]]:
    """Return places along a path backwards from here: no axis goes more than ``step`` between two, nor ``distance``."""
    places, at, left = [], dict(here), distance
    for place in reversed(path):
        start, target = at, {**at, **place}
        way = _farthest(start, target)
        if way == 0:
            continue
        part = min(1.0, left / way)
        steps = math.ceil(way * part / step)
        for i in range(1, steps + 1):
            at = {axis: start[axis] + (target[axis] - start[axis]) * part * i / steps for axis in start}
            places.append(at)
        if (left := left - way) <= 0:
            break
    return places
