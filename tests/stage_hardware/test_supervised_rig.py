"""A supervised rig of stages and a sensor without wires: whatever goes wrong stops it, and is told."""

import math
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import cycle, pairwise
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from stage_hardware.emulators.mock_force_sensor import MockForceSensor
from stage_hardware.emulators.mock_stage import MockStage
from stage_hardware.force_sensor import Component, ForceReading
from stage_hardware.rig.rig import Frame, Rig
from stage_hardware.rig.supervised_rig import ForceWatch, SupervisedRig, _back
from stage_hardware.stage import Axis, StageState

from neurorobo.bodies.pacer import Overrun
from neurorobo.safety.limits import Limits
from neurorobo.safety.machine import Latch, SafetyError, SafetyMachine, SafetyState
from tests.stage_hardware.rigs import until

PERIOD_NS = 100_000_000
STOP_MN, LATCH_MN = 100.0, 300.0
MS = 1_000_000


class Bench:
    """Two mock stages, z and x, and a sensor that feels how far z is beyond 50 um or below ``floor``, and ``push``."""

    def __init__(self, folder: Path, overrun: Overrun = "skip") -> None:
        def axis(speed_um_s: float) -> Axis:
            return Axis("um", 0.0, 2000.0, 0.1, speed_um_s, 200_000.0)

        self.z = MockStage("elevator", {"z": axis(4000.0)}, positions={"z": 30.0}, beyond=100.0)
        self.x = MockStage("table", {"x": axis(4000.0)}, positions={"x": 30.0}, beyond=100.0)
        self.stiffness_mN_um, self.push_mN, self.floor_um = 0.0, 0.0, -math.inf
        self.sensor = MockForceSensor("force sensor", {"Fx": Component("mN", 1e6, 1.0)}, self._wrench, silence_s=0.6)
        rig = Rig(
            {"elevator": self.z, "table": self.x},
            {"z": Frame(100.0), "x": Frame(50.0)},
            self.sensor,
        )
        self.latch = Latch(folder / "rig.latch.json")
        self.machine = SafetyMachine(self.latch)
        limits = Limits(stop=STOP_MN, latch=LATCH_MN, rate=1e6, age_ns=300 * MS)
        self.force = ForceWatch("force", ("Fx",), limits)
        self.rig = SupervisedRig(
            rig,
            self.machine,
            [self.force],
            overrun=overrun,
            following_error=2.0,
            retracts=60.0,
            retracts_by=10.0,
            load=self._load,
        )

    @staticmethod
    def _load(reading: ForceReading) -> float:
        return abs(reading.values["Fx"])

    def _wrench(self, time_s: float) -> tuple[float, ...]:
        within_um = max(0.0, self.depth_um - 50.0, self.floor_um - self.depth_um)
        return (self.push_mN + self.stiffness_mN_um * within_um,)

    @property
    def depth_um(self) -> float:
        return self.z.mechanisms["z"].position - 100.0

    def ready(self) -> SupervisedRig:
        self.machine.arm()
        self.rig.begin()
        self.rig.home([["z"], ["x"]])
        self.rig.go_to({"z": 0.0, "x": 0.0}, 500.0)
        self.rig.bias()
        self.rig.start_pace()
        return self.rig

    def insert(self, step_um: float = 10.0, periods: int = 100) -> None:
        """Move as a control loop does, until something stops it."""
        for period in range(1, periods + 1):
            self.rig.send({"z": period * step_um})
            self.rig.end_period(PERIOD_NS)
            self.rig.feel()

    def stands(self) -> bool:
        mechanisms = (*self.z.mechanisms.values(), *self.x.mechanisms.values())
        before = [mechanism.position for mechanism in mechanisms]
        time.sleep(0.03)
        return before == [mechanism.position for mechanism in mechanisms]


@pytest.fixture
def bench(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Bench]:
    before = set(threading.enumerate())
    built = Bench(tmp_path, *getattr(request, "param", ()))
    try:
        yield built
    finally:
        built.rig.close()
    assert set(threading.enumerate()) == before


def soon(act: Callable[[], object], after_s: float = 0.15) -> threading.Timer:
    timer = threading.Timer(after_s, act)
    timer.start()
    return timer


def stopped(bench: Bench, run: Callable[[], None]) -> str:
    with pytest.raises(SafetyError) as raised:
        run()
    assert bench.stands()
    assert bench.machine.state in (SafetyState.STOPPED, SafetyState.LATCHED)
    with pytest.raises(SafetyError):
        bench.rig.send({"z": 0.0})
    return str(raised.value)


def test_it_homes_goes_to_the_start_and_keeps_pace(bench: Bench) -> None:
    rig = bench.ready()
    began_s = time.monotonic()
    bench.insert(periods=5)
    assert time.monotonic() - began_s >= 0.5
    assert bench.depth_um == pytest.approx(50.0)
    rig.halt()
    assert bench.machine.state is SafetyState.ARMED
    timing = rig.timing()
    assert timing["tripped_ns"] is None
    assert 0 <= timing["stop_sent_after_ms"] <= min(timing["stood_ms"].values())
    assert timing["sent_ms"].keys() == timing["stood_ms"].keys() == {"elevator", "table"}
    assert rig.standstill().startswith("all axes were sent a stop within ")
    rig.begin()
    assert rig.standstill() == ""


def test_a_rig_that_was_not_armed_does_not_even_connect(bench: Bench) -> None:
    with pytest.raises(SafetyError, match="`--arm`"):
        bench.rig.begin()
    assert not bench.z._connected


def test_an_axis_that_lags_behind_stops_all(bench: Bench) -> None:
    bench.ready()
    soon(lambda: setattr(bench.z.mechanisms["z"], "slowness", 1000.0))
    told = stopped(bench, bench.insert)
    assert "elevator: axis z is still under way" in told and "following_error" in told
    assert "all axes were stopped and stand" in told


def test_an_axis_that_loses_its_reference_moves_no_more(bench: Bench) -> None:
    bench.ready()
    soon(bench.z.power_cycle)
    told = stopped(bench, bench.insert)
    assert told.startswith("elevator: ")


def test_an_axis_that_was_not_homed_is_not_sent_anywhere(bench: Bench) -> None:
    bench.machine.arm()
    bench.rig.begin()
    here = bench.z.mechanisms["z"].position
    told = stopped(bench, lambda: bench.rig.send({"z": 0.0}))
    assert "axis z does not know where it is; home it first" in told
    assert bench.z.mechanisms["z"].position == here


def test_a_sensor_that_falls_silent_stops_it_and_it_is_not_drawn_back(bench: Bench) -> None:
    bench.ready()
    soon(lambda: setattr(bench.sensor, "silent", True))
    told = stopped(bench, bench.insert)
    assert "force: its last reading is" in told and "drawn back" not in told


def test_a_sensor_that_falls_silent_with_its_bias_is_not_forgotten(bench: Bench) -> None:
    """Forgetting readings for the bias must not make their age unknown."""
    rig = bench.ready()
    bench.sensor.silent = True
    time.sleep(0.005)
    rig.force_watches[0].forget()
    told = stopped(bench, bench.insert)
    assert "its last reading is" in told


def test_a_faulty_reading_stops_it(bench: Bench) -> None:
    bench.ready()
    soon(lambda: setattr(bench.sensor, "fault", "saturated"))
    assert "force: saturated" in stopped(bench, bench.insert)


def test_after_too_large_a_force_it_is_drawn_back_while_the_force_falls(bench: Bench) -> None:
    bench.ready()
    bench.stiffness_mN_um = 5.0
    told = stopped(bench, bench.insert)
    assert "force: " in told and "of 100 mN allowed" in told
    assert "drawn back by 60 um, the load went from" in told
    assert bench.depth_um < 50.0  # it was stopped some 20 um beyond
    assert bench.latch.reason() is None


def test_a_load_that_rises_on_the_way_back_latches(bench: Bench) -> None:
    bench.ready()
    bench.stiffness_mN_um = 5.0

    def traps() -> None:
        while bench.z.mechanisms["z"].velocity >= 0:
            time.sleep(0.001)
        bench.push_mN = 100.0

    trap = threading.Thread(target=traps, daemon=True)
    trap.start()
    told = stopped(bench, bench.insert)
    assert "on the way back the load rose" in told and "is latched" in told
    assert "retraction" in str(bench.latch.reason())


def test_a_sensor_that_fails_on_the_way_back_ends_it(bench: Bench) -> None:
    bench.ready()
    bench.stiffness_mN_um = 5.0

    def fails() -> None:
        while bench.z.mechanisms["z"].velocity >= 0:
            time.sleep(0.001)
        bench.sensor.silent = True
        bench.z.mechanisms["z"].slowness = 1000.0

    threading.Thread(target=fails, daemon=True).start()
    told = stopped(bench, bench.insert)
    assert "not drawn back any further: force sensor: no reading for" in told


def test_a_load_beyond_the_latch_is_not_drawn_back_and_holds_for_the_next_run(bench: Bench, tmp_path: Path) -> None:
    bench.ready()
    soon(lambda: setattr(bench, "push_mN", 400.0))
    told = stopped(bench, bench.insert)
    assert "of 300 mN allowed" in told and "drawn back" not in told
    assert "remove" in told and str(bench.latch.path) in told
    bench.rig.close()
    with pytest.raises(SafetyError, match="it is latched"):
        Bench(tmp_path).machine.arm()


def test_a_loop_that_says_nothing_is_stopped_on_its_way(bench: Bench) -> None:
    bench.ready()
    bench.insert(periods=2)
    bench.z.mechanisms["z"].slowness = 1000.0
    bench.rig.send({"z": 1000.0})  # and then it hangs
    time.sleep(0.7)
    assert bench.stands()
    assert bench.depth_um < 100
    told = stopped(bench, lambda: bench.rig.send({"z": 30.0}))
    assert "deadline: the control loop has said nothing for" in told


def late(bench: Bench) -> None:
    time.sleep(1.2 * PERIOD_NS * 1e-9)
    bench.rig.send({"z": 30.0})
    bench.rig.end_period(PERIOD_NS)


@pytest.mark.parametrize("bench", [("stop",)], indirect=True)
def test_a_missed_deadline_stops_it_and_no_axis_is_blamed(bench: Bench) -> None:
    bench.ready()
    told = stopped(bench, lambda: late(bench))
    assert told.startswith("deadline: period 1 of 100 ms ended") and "ms late" in told


@pytest.mark.parametrize("bench", [("hold",), ("skip",)], indirect=True)
def test_a_late_command_is_still_carried_out_if_that_is_allowed(bench: Bench) -> None:
    rig = bench.ready()
    late(bench)
    assert bench.depth_um == pytest.approx(30.0)
    assert rig.timing()["overruns"] >= 1


@pytest.mark.parametrize("bench", [("hold",)], indirect=True)
def test_an_axis_that_still_settles_where_it_was_sent_is_late_and_not_astray(bench: Bench) -> None:
    rig, ask = bench.ready(), bench.z.state
    settles_until_s = time.monotonic() + 1.3 * PERIOD_NS * 1e-9

    def settling() -> StageState:
        state = ask()
        z = replace(state.axes["z"], moving=time.monotonic() < settles_until_s)
        return replace(state, axes={"z": z})

    bench.z.state = settling  # type: ignore[method-assign]
    rig.send({"z": 30.0})
    states = rig.end_period(PERIOD_NS)
    assert not states["z"].moving
    assert rig.timing()["overruns"] == 1


def test_a_halt_stops_what_moves_and_sees_that_it_stands(bench: Bench) -> None:
    bench.ready()
    bench.z.mechanisms["z"].slowness = 100.0
    bench.rig.send({"z": 1000.0})
    assert bench.z.mechanisms["z"].moving
    bench.rig.halt()
    assert bench.stands()


def test_a_stage_that_cannot_be_stopped_is_latched_and_the_other_stands(bench: Bench) -> None:
    bench.ready()

    def unplugs() -> None:
        bench.z.unplugged = True

    soon(unplugs)
    told = stopped(bench, bench.insert)
    assert "elevator: the line is gone" in told and "cut its power" in told
    assert bench.machine.state is SafetyState.LATCHED
    assert "table" in bench.rig.watch.stood_ms


def test_a_trip_that_nobody_was_told_of_is_told_at_the_end(bench: Bench) -> None:
    bench.ready()
    bench.insert(periods=2)
    bench.push_mN = 150.0
    time.sleep(0.1)
    with pytest.raises(SafetyError, match="of 100 mN allowed"):
        bench.rig.halt()


def test_a_refusal_stops_all(bench: Bench) -> None:
    bench.ready()
    soon(lambda: setattr(bench.z, "refusals", 1))
    assert "elevator: the command was refused" in stopped(bench, bench.insert)


def test_what_does_not_stop_after_a_load_beyond_the_latch_is_not_said_to_stand(bench: Bench) -> None:
    bench.ready()

    def fails() -> None:
        bench.z.unplugged = True
        bench.push_mN = 400.0

    def waits() -> None:
        time.sleep(0.3)
        bench.rig.feel()

    soon(fails, 0.05)
    told = stopped(bench, waits)
    assert "of 300 mN allowed" in told and "stopped and stand" not in told
    assert "it may still move, cut its power: elevator: " in told


def test_a_load_that_passes_the_latch_after_the_stop_is_not_drawn_back_and_blames_no_controller(bench: Bench) -> None:
    bench.ready()

    def pushes() -> None:
        bench.push_mN = 150.0
        time.sleep(0.05)
        bench.push_mN = 400.0

    def waits() -> None:
        time.sleep(0.4)
        bench.rig.feel()

    soon(pushes, 0.05)
    told = stopped(bench, waits)
    assert "of 100 mN allowed" in told and "all axes were stopped and stand" in told
    assert "drawn back" not in told and "cut its power" not in told
    assert "is latched: force" in told and "of 300 mN allowed" in told


@pytest.mark.parametrize("begins", ["move_to", "home"])
def test_a_command_that_overtakes_a_stop_is_stopped_as_well(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, begins: str
) -> None:
    """The trip comes when the command was decided on and has not gone out yet."""
    rig = bench.ready()
    begin = getattr(bench.x, begins)
    bench.x.mechanisms["x"].slowness = 1000.0
    bench.x.mechanisms["x"].referenced = begins == "move_to"

    def overtakes(what: object) -> None:
        bench.sensor.fault = "saturated"
        assert rig.watch.wait_until_all_stand()
        begin(what)

    monkeypatch.setattr(bench.x, begins, overtakes)
    act = {"move_to": lambda: rig.send({"x": 1000.0}), "home": lambda: rig.home([["x"]])}[begins]
    told = stopped(bench, act)
    assert "force: saturated" in told and "all axes were stopped and stand" in told


def test_a_rig_whose_stop_was_overtaken_is_stopped_even_if_the_command_fails(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = bench.ready()
    begin = bench.z.move_to
    bench.z.mechanisms["z"].slowness = 1000.0
    bench.x.refusals = 1

    def overtakes(targets: dict[str, float]) -> None:
        bench.sensor.fault = "saturated"
        assert rig.watch.wait_until_all_stand()
        begin(targets)

    monkeypatch.setattr(bench.z, "move_to", overtakes)
    stopped(bench, lambda: rig.send({"z": 1000.0, "x": 1000.0}))


def test_a_trip_while_it_waits_for_the_end_of_a_period_is_dealt_with_at_once(bench: Bench) -> None:
    rig = bench.ready()
    soon(lambda: setattr(bench, "push_mN", 150.0), 0.3)

    def waits() -> None:
        rig.send({"z": 10.0})
        rig.end_period(5_000_000_000)

    began_s = time.monotonic()
    stopped(bench, waits)
    assert time.monotonic() - began_s < 3.0


@pytest.mark.parametrize("bench", [("skip",)], indirect=True)
def test_a_loop_that_was_late_has_as_long_for_the_next_period_as_any(bench: Bench) -> None:
    rig = bench.ready()
    late(bench)  # which takes two periods of 100 ms
    time.sleep(0.24)  # less than the period and 200 ms more that a loop may take
    rig.send({"z": 31.0})


def test_an_episode_that_begins_while_another_is_under_way_may_take_its_time(bench: Bench) -> None:
    rig = bench.ready()
    bench.insert(periods=1)
    rig.begin()
    bench.z.mechanisms["z"].slowness = 3.0
    rig.go_to({"z": 1000.0}, 2000.0)
    assert bench.depth_um == pytest.approx(1000.0)


def test_an_axis_that_runs_into_something_on_its_way_down_is_drawn_back_up(bench: Bench) -> None:
    """Whichever way positions grow: back is where it came from, and not where it would have gone."""
    rig = bench.ready()
    bench.floor_um, bench.stiffness_mN_um = -30.0, 5.0
    rig.go_to({"z": 40.0}, 20.0)
    told = stopped(bench, lambda: rig.go_on_to({"z": -80.0}, 15.0))
    assert "drawn back by 60 um" in told
    assert bench.depth_um > -30.0


def test_what_was_sent_down_and_met_something_is_not_sent_on(bench: Bench) -> None:
    rig = bench.ready()
    bench.floor_um, bench.stiffness_mN_um = -10.0, 5.0
    rig.go_to({"z": 40.0}, 20.0)
    bench.z.mechanisms["z"].slowness = 10.0
    told = stopped(bench, lambda: rig.track({"z": -90.0}))
    assert "drawn back by 60 um" in told
    assert bench.depth_um > -10.0


def test_too_large_a_load_on_the_way_to_the_start_draws_back_too(bench: Bench) -> None:
    rig = bench.ready()
    rig.path.clear()  # as after a search for the origins
    bench.stiffness_mN_um = 5.0
    told = stopped(bench, lambda: rig.go_to({"z": 85.0}, 10.0))
    assert "drawn back by 60 um" in told
    assert bench.depth_um < 50.0


def test_too_large_a_load_on_the_way_out_does_not_lead_in_again(bench: Bench) -> None:
    rig = bench.ready()
    bench.insert(periods=4)
    bench.z.mechanisms["z"].slowness = 1000.0
    soon(lambda: setattr(bench, "push_mN", 150.0), 0.05)
    told = stopped(bench, lambda: rig.withdraw(100.0))
    assert "not drawn back" in told
    assert bench.depth_um <= 40.0


def test_the_way_back_turns_where_the_way_turned_and_ends_where_it_may() -> None:
    path = [{"z": -40.0, "x": 0.0}, {"z": 10.0, "x": 0.0}, {"z": 10.0, "x": 30.0}]
    way = _back({"z": 10.0, "x": 50.0}, path, 65.0, 10.0)
    assert [place["x"] for place in way] == pytest.approx([40, 30, 20, 10, 0, 0, 0])
    assert [place["z"] for place in way] == pytest.approx([10, 10, 10, 10, 10, 2.5, -5])


@given(
    places=st.lists(st.tuples(st.floats(-500, 500), st.floats(-500, 500)), min_size=1, max_size=8),
    distance=st.floats(1, 300),
    step=st.floats(1, 50),
)
def test_no_step_of_the_way_back_is_too_long_nor_the_way(
    places: list[tuple[float, float]], distance: float, step: float
) -> None:
    path = [{"z": z, "x": x} for z, x in places]
    way = [path[-1], *_back(path[-1], path, distance, step)]
    steps = [max(abs(b[axis] - a[axis]) for axis in a) for a, b in pairwise(way)]
    assert all(one <= step * (1 + 1e-9) for one in steps)
    assert sum(steps) <= distance * (1 + 1e-9)


@pytest.mark.parametrize("reports", ["silence", "nan"])
def test_without_a_load_to_trust_it_is_not_drawn_back_at_all(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, reports: str
) -> None:
    rig = bench.ready()
    bench.stiffness_mN_um = 5.0
    wait = rig.watch.wait_until_all_stand
    sent: list[object] = []

    def fails() -> bool:
        stand = wait()
        if reports == "nan":
            bench.push_mN = math.nan
        else:
            bench.sensor.silence_s, bench.sensor.silent = 0.01, True
        time.sleep(0.05)
        monkeypatch.setattr(bench.z, "move_to", sent.append)
        return stand

    monkeypatch.setattr(rig.watch, "wait_until_all_stand", fails)
    with pytest.raises(SafetyError, match="not drawn back any further: force sensor: "):
        bench.insert()
    assert not sent


def test_a_load_that_creeps_up_on_the_way_back_latches(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each step by less than what counts as a rise, and all together by more."""
    rig = bench.ready()
    rig.go_to({"z": 40.0}, 40.0)
    moves = bench.z.move_to

    def creeps(targets: dict[str, float]) -> None:
        bench.push_mN += 2.0
        moves(targets)

    def pushes() -> None:
        bench.push_mN = 130.0
        until(lambda: bench.sensor.latest().values["Fx"] > 100.0)
        monkeypatch.setattr(bench.z, "move_to", creeps)
        rig.feel()

    rig.path = [{"z": -50.0}, *rig.path]
    assert "on the way back the load rose" in stopped(bench, pushes)


def test_noise_where_nothing_is_touched_any_more_is_no_rise(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    rig = bench.ready()
    rig.path = [{"z": -50.0}, *rig.path]
    moves = bench.z.move_to
    noise = cycle([0.0, 4.0])

    def rattles(targets: dict[str, float]) -> None:
        bench.push_mN = next(noise)
        moves(targets)

    def pushes() -> None:
        bench.push_mN = 130.0
        until(lambda: bench.sensor.latest().values["Fx"] > 100.0)
        monkeypatch.setattr(bench.z, "move_to", rattles)
        rig.feel()

    assert "drawn back by 50 um" in stopped(bench, pushes)
    assert bench.latch.reason() is None


def test_a_sensor_that_falls_silent_before_anybody_listens_stops_the_first_motion(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It has given the reading that it was started with, and gives none to the guards."""
    watch = bench.sensor.watch

    def too_late(watcher: Callable[[ForceReading], None]) -> None:
        bench.sensor.silent = True
        time.sleep(0.01)
        watch(watcher)

    monkeypatch.setattr(bench.sensor, "watch", too_late)
    bench.machine.arm()
    bench.rig.begin()
    bench.z.mechanisms["z"].slowness = 1000.0
    assert "force: its last reading is" in stopped(bench, lambda: bench.rig.home([["z"]]))


def test_an_axis_that_reports_no_number_stops_all(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """No comparison with it holds, so that it would pass for one that has arrived."""
    bench.ready()
    ask = bench.z.state

    def broken() -> StageState:
        state = ask()
        return replace(state, axes={"z": replace(state.axes["z"], position=math.nan)})

    monkeypatch.setattr(bench.z, "state", broken)
    assert "elevator: axis z reports the position nan; see to line" in stopped(bench, bench.insert)


def test_no_axis_sets_out_if_one_would_go_beyond_its_travel(bench: Bench) -> None:
    rig = bench.ready()
    assert "table: axis x would go to 2050 um" in stopped(bench, lambda: rig.send({"z": 500.0, "x": 2000.0}))
    assert bench.depth_um == pytest.approx(0.0)


def test_a_device_that_cannot_be_closed_leaves_no_other_open(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    rig = bench.ready()

    def fails() -> None:
        raise OSError("the port is gone")

    with monkeypatch.context() as patched:
        patched.setattr(bench.z, "close", fails)
        with pytest.raises(OSError, match="the port is gone"):
            rig.close()
    assert not bench.x._connected
    assert not bench.sensor.latest().valid


def test_a_load_that_is_there_when_it_connects_stops_what_then_is_said_to_stand(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    start = bench.rig.watch.start

    def slow() -> None:
        time.sleep(0.05)
        start()

    monkeypatch.setattr(bench.rig.watch, "start", slow)
    bench.push_mN = 150.0
    bench.machine.arm()
    bench.rig.begin()
    until(lambda: bench.machine.trip is not None)
    assert "all axes were stopped and stand" in stopped(bench, lambda: bench.rig.home([["z"]]))


def test_a_mistake_in_a_driver_does_not_keep_the_other_from_being_stopped(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = bench.ready()
    bench.x.mechanisms["x"].slowness = 1000.0
    rig.send({"x": 1000.0})

    def fails() -> None:
        raise KeyError("a mistake")

    with monkeypatch.context() as patched:
        patched.setattr(bench.z, "stop", fails)
        told = stopped(bench, rig.halt)
    assert "cut its power: elevator: KeyError('a mistake')" in told


def test_ctrl_c_on_the_way_back_leaves_nothing_under_way(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    rig = bench.ready()
    rig.path = [{"z": -50.0}, *rig.path]
    moves = bench.z.move_to

    def interrupted(targets: dict[str, float]) -> None:
        bench.z.mechanisms["z"].slowness = 1000.0
        moves(targets)
        raise KeyboardInterrupt

    monkeypatch.setattr(bench.z, "move_to", interrupted)
    bench.push_mN = 150.0
    until(lambda: bench.machine.trip is not None)
    with pytest.raises(KeyboardInterrupt):
        rig.feel()
    assert bench.stands()


def test_a_trip_while_controllers_are_waited_for_is_dealt_with_in_the_thread_of_the_loop(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each controller is waited for in a thread of its own: two that draw back would wait for each other."""
    rig = bench.ready()
    for mechanism in (bench.z.mechanisms["z"], bench.x.mechanisms["x"]):
        mechanism.slowness = 1000.0
    threads: list[threading.Thread] = []
    stands = rig.watch.wait_until_all_stand

    def noted() -> bool:
        threads.append(threading.current_thread())
        return stands()

    monkeypatch.setattr(rig.watch, "wait_until_all_stand", noted)
    rig.send({"z": 1900.0, "x": 1900.0})
    bench.sensor.fault = "saturated"
    told = stopped(bench, lambda: rig.end_period(2_000_000_000) and None)
    assert "all axes were stopped and stand" in told
    assert threads == [threading.current_thread()]
