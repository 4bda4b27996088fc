"""Every fault that an emulated rig can be told to have, in every phase of an insertion, on both rigs of the examples.

Run ``python benchmarks/hardware/fault_matrix.py`` (a quarter of an hour on two cores; ``--only TEXT`` for cases
whose names contain it). Each case is ``run_experiment`` with the body ``precision.hardware_rig`` on emulated
controllers (:mod:`rig_under_test`), a fault that is thrown when a phase is reached, by an observer of the mechanisms,
and a judge:

- a fault that must stop does: the run has failed, its error names device, fault and cure, and all mechanisms stand
  when it has ended and stay so; from the trip to standstill takes no longer than is allowed. A controller that hears
  nothing any more cannot be stopped: the rig is latched, the error says to cut the power, and its axes go no further
  than where they had been sent;
- a fault that must be tolerated is: the run finishes, and lost records are counted right; on the way back after too
  large a force, that goes on to its end;
- the load never exceeds the latch limit, or what a fault has put on at once, by more than
  stiffness * (speed * (sensor + wake-up + link + line + controller) + way of braking);
- the run folder holds a row for each period that was completed, run.json and timing.json;
- nothing hangs, no thread is left, no port stays open.

Nothing here is a device: times are those of emulators on this machine, which may be busy otherwise. The load allowance
is worst for a stop that comes while its line is busy; what was measured of each term is in the output. All cases are
kept in ``fault_matrix.json`` beside this file, and a whole matrix writes the table of ``docs/explanation/safety.md``.
"""

import argparse
import json
import multiprocessing
import os
import statistics
import sys
import tempfile
import threading
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from jam import Jam
from rig_under_test import (
    AXIAL_CONTROLLER,
    AXIAL_LATCH_MN,
    HARD_MN_UM,
    LATCH_MN,
    PERIODS,
    STOP_MN,
    Observer,
    allowance,
    emulated,
    experiment,
    rig_config,
)
from stage_hardware.rig.emulated_rig import EmulatedRig

from neurorobo.config.experiment import load_experiment
from neurorobo.errors import NeuroroboError
from neurorobo.experiment.run import run_experiment
from neurorobo.plugins import Registry

sys.path.append(str(Path(__file__).resolve().parents[1]))

from machine import machine
from page import between

FILE = Path(__file__).with_suffix(".json")
PAGE = Path(__file__).resolve().parents[2] / "docs" / "explanation" / "safety.md"
START, END = "<!-- fault_matrix.json -->", "<!-- end of fault_matrix.json -->"
RIGS = tuple(PERIODS)
PHASES = ("homing", "approach", "insertion", "retraction")
WITHIN_S = 240.0
"""A case that takes longer, with what is repeated of it, hangs."""

PAUSE_MS, REPEATS = 15.0, 3
LATE_S = 0.7
WATCHED_S = 0.2
"""For how long the mechanisms are watched when the run has ended."""

Stops = str
"""What a fault must lead to: `stop`, `latch`, `unreachable` (the controller hears nothing), or `tolerated`."""


@dataclass(frozen=True)
class Case:
    """One fault of one device, in one phase, on one rig; ``lost`` are the records that have to be counted as lost."""

    rig: str
    device: str
    fault: str
    phase: str
    expected: Stops = "stop"
    lost: int = 0
    as_shipped: bool = False

    @property
    def name(self) -> str:
        """Return what it is called."""
        return ".".join((self.rig + "-as-shipped" * self.as_shipped, self.device, self.fault, self.phase))


def _set(where: Any, **values: Any) -> None:
    for name, value in values.items():
        assert hasattr(where, name)
        setattr(where, name, value)


def _hits_limit(emulator: Any, mechanism: Any) -> None:
    """Put a switch in the way: just ahead of an axis that moves, or where it stands."""
    here, ahead = mechanism.position, mechanism.destination - mechanism.position
    if ahead < 0:
        mechanism.lower_switch = here + 0.1 * ahead
    else:
        mechanism.upper_switch = here + 0.1 * ahead


def _slows(emulator: Any, mechanism: Any) -> None:
    mechanism.slowness = 3000.0
    if (ahead := mechanism.destination) != mechanism.position:  # also the motion that is under way
        homing = mechanism._homing
        mechanism.home() if homing else mechanism.move_to(ahead - mechanism.zero)


def _refuses(emulator: Any, mechanism: Any) -> None:
    if hasattr(emulator, "refuse_next"):
        emulator.refuse_next = 7
    elif isinstance(emulator.refusals, list):
        emulator.refusals.append("E22")
    else:
        emulator.refusals = 1


def _motor_off(emulator: Any, mechanism: Any) -> None:
    if hasattr(emulator, "free_motor"):
        emulator.free_motor(0)
    elif hasattr(emulator, "switch_servo_off"):
        emulator.switch_servo_off("1")
    elif hasattr(emulator, "switch_motor_off"):
        emulator.switch_motor_off(1)
    else:
        mechanism.stop(hard=True)
        mechanism.motor_on = False


Throw = Callable[[Any, Any], None]

WIRE: dict[str, tuple[Throw, Stops]] = {
    "no reply": (lambda emulator, _: _set(emulator.faults, no_reply=1), "stop"),
    "late reply": (lambda emulator, _: _set(emulator.faults, late_reply=1, late_s=LATE_S), "stop"),
    "split reply": (lambda emulator, _: _set(emulator.faults, split_reply=1), "tolerated"),
    "garbled reply": (lambda emulator, _: _set(emulator.faults, garbled_reply=1), "stop"),
    "wrong terminator": (lambda emulator, _: _set(emulator.faults, wrong_terminator=1), "stop"),
    "hang-up": (lambda emulator, _: _set(emulator.faults, hang_up=True), "unreachable"),
    "deaf": (lambda emulator, _: _set(emulator.faults, deaf=True), "unreachable"),
}
CONTROLLER: dict[str, tuple[Throw, Stops]] = {
    "refusal": (_refuses, "stop"),
    "limit switch": (_hits_limit, "stop"),
    "motor off": (_motor_off, "stop"),
    "power cycle": (lambda emulator, _: emulator.power_cycle(), "stop"),
    "slow motion": (_slows, "stop"),
}
OF_SOME: dict[str, dict[str, tuple[Throw, Stops]]] = {
    "elevator": {
        "unplugged": (lambda emulator, _: emulator.unplug(0), "stop"),
        "emergency stop": (lambda emulator, _: emulator.press_emergency_stop(), "stop"),
    },
    "axial": {"joystick": (lambda emulator, _: _set(emulator.axes["1"], joystick=True), "stop")},
}


def _takes_stream_over(box: Any) -> None:
    import socket

    from stage_hardware.links import rdt

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.sendto(rdt.REQUEST.pack(rdt.HEADER, rdt.START, 0), (box.host, box.rdt_port))


SENSOR: dict[str, tuple[Callable[[Any], None], Stops, int]] = {
    "drop": (lambda box: _set(box.faults, drop=3), "tolerated", 3),
    "duplicate": (lambda box: _set(box.faults, duplicate=3), "tolerated", 0),
    "swap": (lambda box: _set(box.faults, swap=1), "tolerated", 1),
    "short": (lambda box: _set(box.faults, short=3), "tolerated", 3),
    "foreign port": (lambda box: _set(box.faults, foreign_port=3), "tolerated", 3),
    "foreign address": (lambda box: _set(box.faults, foreign_address=3), "tolerated", 3),
    "short for good": (lambda box: _set(box.faults, short=10**9), "stop", 0),
    "foreign port for good": (lambda box: _set(box.faults, foreign_port=10**9), "stop", 0),
    "status bit": (lambda box: _set(box.faults, status=(1 << 31) | (1 << 17)), "stop", 0),
    "frozen": (lambda box: _set(box.faults, frozen=True), "stop", 0),
    "silence": (lambda box: _set(box.faults, silent=True), "stop", 0),
    "power cycle": (lambda box: box.power_cycle(), "stop", 0),
    "another client": (_takes_stream_over, "stop", 0),
}
LOAD: dict[str, tuple[Callable[[Jam, int], None], Stops]] = {
    "over-force": (lambda jam, _: jam.step(1.5 * STOP_MN), "stop"),
    "over-force beyond the latch": (lambda jam, _: jam.step(4 / 3 * LATCH_MN), "latch"),
    "axial over-force": (lambda jam, _: jam.step(0.0, 6000.0), "stop"),
    "axial over-force beyond the latch": (lambda jam, _: jam.step(0.0, 10_000.0), "latch"),
    "rises too fast": (lambda jam, _: jam.rise(40_000.0, 0.8 * STOP_MN), "stop"),
    "hard wall": (lambda jam, direction: jam.hard(HARD_MN_UM, direction), "stop"),
}


def cases() -> Iterator[Case]:
    """Yield all cases."""
    for rig in RIGS:
        for device in ("radial", AXIAL_CONTROLLER[rig]):
            for fault, (_, expected) in (WIRE | CONTROLLER | OF_SOME.get(device, {})).items():
                for phase in PHASES:
                    yield Case(rig, device, fault, phase, expected)
        for fault, (_, expected, lost) in SENSOR.items():
            for phase in PHASES:
                yield Case(rig, "force_sensor", fault, phase, expected, lost)
        for fault, (_, expected) in LOAD.items():
            for phase in PHASES:
                # What is put on a rig that is drawn back makes the load rise on the way.
                yield Case(rig, "load", fault, phase, "latch" if phase == "retraction" else expected)
        for fault in ("hang", "missed deadline"):
            yield Case(rig, "brain", fault, "loop")
        for fault in ("over-force", "over-force beyond the latch", "hard wall", "rises too fast"):
            expected = LOAD[fault][1]
            yield Case(rig, "load", fault, "insertion", expected, as_shipped=True)


def judged(case: Case) -> dict[str, Any]:
    """Run a case, and return what became of it; ``failures`` is empty if that is as it must be.

    One that fails while this process got no processor for longer than :data:`PAUSE_MS`, or that missed a deadline
    before its fault was thrown, is run again, and counted in ``repeated``: guards trip on such a pause, as they must.
    """
    for repeated in range(REPEATS + 1):
        with tempfile.TemporaryDirectory() as folder:
            outcome = {**_Run(case, Path(folder)).outcome(), "repeated": repeated}
        late = "the phase was not reached" in outcome["failures"] and "late" in (outcome.get("error") or "")
        if not outcome["failures"] or (outcome["longest_pause_ms"] < PAUSE_MS and not late):
            break
    return outcome


class _Run:
    """One run of a case."""

    def __init__(self, case: Case, folder: Path) -> None:
        self.case, self.folder = case, folder
        self.failures: list[str] = []
        self.found: dict[str, Any] = {"case": case.name, **asdict(case), "longest_pause_ms": 0.0}

    def outcome(self) -> dict[str, Any]:
        case = self.case
        config = rig_config(case.rig, self.folder, as_shipped=case.as_shipped)
        ports = _ports()
        with emulated(config, as_shipped=case.as_shipped) as rig:
            self.rig, self.physics = rig, _jam(rig)
            overrun = "stop" if case.fault == "missed deadline" else "skip"
            path = experiment(case.rig, self.folder, rig, as_shipped=case.as_shipped, overrun=overrun)
            observer = self.observer = Observer(rig, case.phase, self._axes(), self._inject)
            threads = set(threading.enumerate())
            with observer:
                self._run(path)
                time.sleep(WATCHED_S)
            self._judge_end()
            self._see(_leaves(lambda: set(threading.enumerate()) - threads - {observer._thread}), "threads left")
        self._see(_leaves(lambda: _ports() - ports), "ports left open")
        return {**self.found, "failures": self.failures}

    def _axes(self) -> tuple[str, ...]:
        device = self.case.device
        return tuple(self.rig.controllers[device].axes) if device in self.rig.controllers else ("z",)

    def _inject(self) -> None:
        case = self.case
        if case.device == "brain":
            return  # it is the loop that hangs
        if case.device == "load":
            jam, (throw, _) = self.physics, LOAD[case.fault]
            upwards = self.rig.controllers[AXIAL_CONTROLLER[case.rig]].axes["z"].mechanism.velocity > 0
            throw(jam, 1 if upwards else -1)
            if case.fault == "rises too fast" and case.phase == "retraction":
                jam.rise(40_000.0, 2 * STOP_MN)  # faster than it falls on the way
            return
        if case.device == "force_sensor":
            SENSOR[case.fault][0](self.rig.box)
            return
        stage = self.rig.controllers[case.device]
        moving = next((one for one in stage.axes.values() if one.mechanism.velocity), next(iter(stage.axes.values())))
        for faults in (WIRE, CONTROLLER, OF_SOME.get(case.device, {})):
            if case.fault in faults:
                faults[case.fault][0](stage.emulator, moving.mechanism)
        if case.expected == "unreachable":
            self.sent_to = {name: axis.mechanism.destination for name, axis in stage.axes.items()}

    def _period_begins(self, tick: int, running: int) -> None:
        self.observer.begun = tick + 1
        if self.case.device == "brain" and tick == 3:
            period_s = float(PERIODS[self.case.rig].split()[0]) * 1e-3
            self.observer.injected_ns = time.monotonic_ns()
            time.sleep(2.0 if self.case.fault == "hang" else 1.1 * period_s)

    def _run(self, path: Path) -> None:
        registry = Registry.discover()
        out = self.folder / "run"
        self.error: str | None = None
        began_s = time.monotonic()
        try:
            loaded = load_experiment(path, (), registry)
            run_experiment(loaded, registry, [7], out, arm=True, progress=self._period_begins)
        except NeuroroboError as error:
            self.error = str(error)
        except Exception:
            self.error = traceback.format_exc()
            self.failures.append("ended in a traceback")
        self.ended_ns = time.monotonic_ns()
        self.found |= {"seconds": round(time.monotonic() - began_s, 2), "error": self.error}

    def _judge_end(self) -> None:
        case, observer = self.case, self.observer
        run, timing = (_json(self.folder / "run" / name) for name in ("run.json", "timing.json"))
        self._see(observer.error, "the observer failed")
        self.found["longest_pause_ms"] = round(observer.longest_pause_ms, 1)
        if observer.injected_ns is None:
            self.failures.append("the phase was not reached")
            return
        self._see(self.rig.fault, "physics")
        is_over = case.phase == "retraction" or case.expected != "tolerated"
        self._expect(run.get("status") == ("failed" if is_over else "finished"), f"status {run.get('status')}")
        self._expect(run.get("error") == self.error, "run.json has another error")
        self._expect(bool(timing), "no timing.json")
        rows, begun = _rows(self.folder / "run" / "trajectory.parquet"), observer.begun
        completed = begun - is_over if begun else 0
        self._expect(rows == completed, f"{rows} rows of {completed} periods")
        if case.expected == "tolerated":
            if case.device == "force_sensor":
                self._expect(timing.get("readings_lost") == case.lost, f"{timing.get('readings_lost')} counted as lost")
            if case.phase == "retraction":
                self._expect("drawn back by" in (self.error or ""), "the way back was given up")
        else:
            self._judge_error()
        self._judge_motion(timing)
        self._judge_load(timing)

    def _judge_error(self) -> None:
        case, error = self.case, self.error or ""
        device = {"force_sensor": "force", "load": "force", "brain": "deadline"}.get(case.device, case.device)
        self._expect(device in error, f"does not name {device}")
        self._expect(";" in error, "names no cure")
        latched = (self.folder / f"{case.rig}.latch.json").exists()
        self._expect(latched or case.expected not in ("latch", "unreachable"), "is not latched")
        if case.expected == "unreachable":
            self._expect("cut" in error and "power" in error, "does not say to cut the power")
        elif case.expected == "stop":
            self._expect(not latched or case.phase == "retraction", "is latched")
            self._expect("were stopped and stand" in error or latched, "does not say that all stand")
        if case.phase == "retraction":
            self._expect("drawn back" in error, "does not tell of the way back")

    def _judge_motion(self, timing: dict[str, Any]) -> None:
        case, observer = self.case, self.observer
        injected_ns, tripped_ns = observer.injected_ns, timing.get("tripped_ns")
        assert injected_ns is not None
        self.found["reaction_ms"] = timing.get("stop_sent_after_ms")
        moved = [look for look in observer.moved if look[0] > injected_ns]
        if case.expected == "unreachable":
            stage = self.rig.controllers[case.device]
            others = set(observer.mechanisms) - set(stage.axes)
            for name, there in self.sent_to.items():
                self._expect(abs(stage.axes[name].mechanism.destination - there) < 1e-6, f"{name} was sent elsewhere")
        else:
            others = set(observer.mechanisms)
        after = [set(look[1]) & others for look in moved if look[0] > self.ended_ns]
        self._expect(bool(after) and not any(after), "something moves after the end")
        if case.expected == "tolerated" or tripped_ns is None:
            return
        # Standstill is where the motion ends that was under way at the trip; a way back comes later, and goes back.
        last_ns = tripped_ns
        goes_on = case.phase == "retraction"
        for look_ns, axes, _, goes_back in moved:
            if look_ns > tripped_ns and set(axes) & others and (goes_on or not goes_back or case.phase == "homing"):
                last_ns = look_ns
            elif look_ns > tripped_ns and not goes_on:
                break
        self.found["inject_to_trip_ms"] = round((tripped_ns - injected_ns) / 1e6, 2)
        self.found["inject_to_stand_ms"] = round((last_ns - injected_ns) / 1e6, 2)
        if goes_on:
            return
        self.found["trip_to_stand_ms"] = round((last_ns - tripped_ns) / 1e6, 2)
        allowed_s = allowance(case.rig, as_shipped=case.as_shipped).stops_s
        if case.device == "radial":  # SHOT: `Q:` takes 31 characters at 38400; Corvus: ramps
            allowed_s += 0.03
        if case.fault == "late reply":  # it hears no stop before that
            allowed_s += LATE_S
        self._expect(last_ns - tripped_ns <= allowed_s * 1e9, f"{(last_ns - tripped_ns) / 1e6:.0f} ms to standstill")

    def _judge_load(self, timing: dict[str, Any]) -> None:
        case, observer = self.case, self.observer
        injected_ns, tripped_ns = observer.injected_ns, timing.get("tripped_ns")
        assert injected_ns is not None
        felt = [load for load in self.physics.felt if load.time_ns > injected_ns]
        if not felt:
            return
        most, at_once = max(load.radial_mN for load in felt), felt[0].radial_mN
        most_axial, at_once_axial = max(load.axial_mN for load in felt), felt[0].axial_mN
        allowed = allowance(case.rig, as_shipped=case.as_shipped)
        beyond, beyond_axial = map(allowed.load_mN, self.physics.slopes_mN_um)
        self._expect(most <= max(LATCH_MN, at_once) + beyond, f"{most:.0f} mN across")
        self._expect(most_axial <= max(AXIAL_LATCH_MN, at_once_axial) + beyond_axial, f"{most_axial:.0f} mN along")
        if case.fault == "hard wall" and case.phase in ("homing", "insertion"):
            # The limit that is crossed is the stop limit: the tightest form of the same.
            crossed_ns = next((load.time_ns for load in felt if load.radial_mN > STOP_MN), None)
            self.found["beyond_stop_mN"] = round(most - STOP_MN, 1)
            self.found["allowed_mN"] = round(beyond, 1)
            if crossed_ns and tripped_ns:
                self.found["cross_to_trip_ms"] = round((tripped_ns - crossed_ns) / 1e6, 2)
            self._expect(
                most <= STOP_MN + beyond, f"{most - STOP_MN:.0f} mN beyond the stop limit, {beyond:.0f} allowed"
            )

    def _expect(self, holds: bool, otherwise: str) -> None:
        if not holds:
            self.failures.append(otherwise)

    def _see(self, what: object, label: str) -> None:
        if what:
            self.failures.append(f"{label}: {what}")


def _jam(rig: EmulatedRig) -> Jam:
    assert isinstance(rig.physics, Jam)
    return rig.physics


def _json(path: Path) -> dict[str, Any]:
    with suppress(OSError):
        content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        return content
    return {}


def _rows(path: Path) -> int:
    if not path.exists():
        return 0
    import pyarrow.parquet

    rows: int = pyarrow.parquet.read_metadata(path).num_rows
    return rows


def _ports() -> Counter[str]:
    """Count the sockets and terminals that this process has open, by what they are."""
    found: Counter[str] = Counter()
    for name in os.listdir("/proc/self/fd"):
        with suppress(OSError):
            target = os.readlink(f"/proc/self/fd/{name}")
            if target.startswith(("socket:", "/dev/pts/", "/dev/ptmx")):
                found[target] += 1
    return found


def _leaves(what: Callable[[], Any], within_s: float = 2.0) -> Any:
    """Return what is left after a while, which is nothing if all is well."""
    deadline = time.monotonic() + within_s
    while (left := what()) and time.monotonic() < deadline:
        time.sleep(0.01)
    return left


def serve(pipe: Connection) -> None:
    """Run cases, in a process of its own, until there are no more."""
    while (case := pipe.recv()) is not None:
        try:
            outcome = judged(case)
        except Exception:
            outcome = {"case": case.name, **asdict(case), "failures": [traceback.format_exc()]}
        pipe.send(outcome)


class Lane:
    """A process that runs cases one after the other, and is ended if one hangs."""

    def __init__(self) -> None:
        """Prepare it."""
        self._spawn = multiprocessing.get_context("spawn")
        self._process: Any = None

    def judged(self, case: Case) -> dict[str, Any]:
        """Run a case."""
        if self._process is None:
            self._pipe, theirs = self._spawn.Pipe()
            self._process = self._spawn.Process(target=serve, args=(theirs,), daemon=True)
            self._process.start()
        self._pipe.send(case)
        if self._pipe.poll(WITHIN_S):
            with suppress(EOFError):
                outcome: dict[str, Any] = self._pipe.recv()
                return outcome
        self._process.kill()
        self._process.join()
        self._process = None
        return {"case": case.name, **asdict(case), "failures": [f"hangs, or ended its process, in {WITHIN_S:g} s"]}

    def close(self) -> None:
        """End it."""
        if self._process is not None:
            self._pipe.send(None)
            self._process.join()


def judged_side_by_side(chosen: Sequence[Case], lanes: int) -> list[dict[str, Any]]:
    """Run cases in some processes, and return what became of them, in their order."""
    waiting, outcomes = iter(enumerate(chosen)), dict[int, dict[str, Any]]()
    lock = threading.Lock()

    def run() -> None:
        lane = Lane()
        while True:
            with lock:
                index, case = next(waiting, (-1, None))
            if case is None:
                break
            outcome = outcomes[index] = lane.judged(case)
            with lock:
                told = "; ".join(outcome["failures"]) or "ok"
                told += f" (repeated {outcome['repeated']} times)" if outcome.get("repeated") else ""
                print(
                    f"{len(outcomes):4}/{len(chosen)}  {outcome.get('seconds', 0):5.1f} s  {case.name}: {told}",
                    flush=True,
                )
        lane.close()

    threads = [threading.Thread(target=run) for _ in range(lanes)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return [outcomes[index] for index in range(len(chosen))]


def figures(outcomes: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return the distributions of what was measured: median, 99th percentile and largest."""

    def spread(values: list[float]) -> dict[str, float] | None:
        if not values:
            return None
        ordered = sorted(values)
        return {
            "count": len(ordered),
            "p50": round(statistics.median(ordered), 2),
            "p99": round(ordered[min(len(ordered) - 1, int(0.99 * len(ordered)))], 2),
            "max": round(ordered[-1], 2),
        }

    def of(key: str, rig: str, *, as_shipped: bool = False) -> list[float]:
        return [
            outcome[key]
            for outcome in outcomes
            if outcome.get(key) is not None
            and outcome["rig"] == rig
            and outcome["as_shipped"] is as_shipped
            and not (key == "trip_to_stand_ms" and outcome["fault"] == "late reply")
        ]

    keys = (
        "reaction_ms",
        "trip_to_stand_ms",
        "inject_to_trip_ms",
        "inject_to_stand_ms",
        "cross_to_trip_ms",
        "beyond_stop_mN",
    )
    found: dict[str, Any] = {}
    for rig in RIGS:
        for shipped in (False, True):
            allowed = allowance(rig, as_shipped=shipped)
            found[rig + "-as-shipped" * shipped] = {
                "allowance": {
                    **asdict(allowed),
                    "stops_s": allowed.stops_s,
                    "load_mN_at_hard_wall": allowed.load_mN(HARD_MN_UM + 0.5),
                },
                **{key: spread(of(key, rig, as_shipped=shipped)) for key in keys},
            }
    return found


_TIMES = ("reaction_ms", "trip_to_stand_ms")


def table(content: dict[str, Any]) -> str:
    """Return what was measured as a table in Markdown."""
    rows = [
        "| rig | cases | stops sent after, ms: p50, p99, max | standstill after, ms: p50, p99, max | allowed, ms | "
        "beyond the limit at a hard wall, mN | allowed, mN |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name, found in content["figures"].items():
        of_rig = [one for one in content["cases"] if one["rig"] + "-as-shipped" * one["as_shipped"] == name]
        as_wanted = sum(not one["failures"] for one in of_rig)
        cells = (
            name.replace("-as-shipped", ", at the pace of the example"),
            f"{as_wanted} of {len(of_rig)}",
            *(", ".join(f"{found[key][of]:.1f}" for of in ("p50", "p99", "max")) for key in _TIMES),
            f"{1e3 * found['allowance']['stops_s']:.0f}",
            f"{found['beyond_stop_mN']['max']:.0f}",
            f"{found['allowance']['load_mN_at_hard_wall']:.0f}",
        )
        rows.append(f"| {' | '.join(cells)} |")
    return "\n".join(rows)


def into_page(text: str, content: dict[str, Any]) -> str:
    """Return a page with its table replaced."""
    return between(text, START, END, table(content))


def show(outcomes: Sequence[dict[str, Any]]) -> None:
    """Print a table of faults and phases, and what was measured."""
    phases = (*PHASES, "loop")
    rows: dict[tuple[str, str, str], dict[str, str]] = {}
    for outcome in outcomes:
        key = outcome["rig"] + "-as-shipped" * outcome["as_shipped"], outcome["device"], outcome["fault"]
        rows.setdefault(key, {})[outcome["phase"]] = "FAILED" if outcome["failures"] else outcome["expected"]
    print(f"{'rig':22}{'device':14}{'fault':36}" + "".join(f"{phase:13}" for phase in phases))
    for (rig, device, fault), by_phase in rows.items():
        print(f"{rig:22}{device:14}{fault:36}" + "".join(f"{by_phase.get(phase, ''):13}" for phase in phases))
    for rig, found in figures(outcomes).items():
        print(f"\n{rig}")
        for key, value in found.items():
            print(f"  {key}: {value}")


def main() -> int:
    """Run the matrix."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="cases whose names contain one of these, apart by commas")
    parser.add_argument(
        "--failed", action="store_true", help="those that failed in the file of the last time, once more"
    )
    parser.add_argument("--lanes", type=int, default=2, help="processes side by side")
    parser.add_argument("--out", type=Path, default=FILE, help="where to write all cases")
    arguments = parser.parse_args()
    chosen = [case for case in cases() if any(part in case.name for part in arguments.only.split(","))]
    before = {one["case"]: one for one in _json(arguments.out).get("cases", ())} if arguments.failed else {}
    chosen = [case for case in chosen if not before or before[case.name]["failures"]]
    began_s = time.monotonic()
    outcomes = judged_side_by_side(chosen, arguments.lanes)
    for outcome in outcomes:
        if outcome["case"] in before:
            outcome["failed_before"] = before[outcome["case"]]["failures"]
    outcomes = list({**before, **{outcome["case"]: outcome for outcome in outcomes}}.values())
    show(outcomes)
    failed = [outcome for outcome in outcomes if outcome["failures"]]
    minutes = (time.monotonic() - began_s) / 60
    repeated = sum(outcome.get("repeated", 0) > 0 for outcome in outcomes)
    print(f"\n{len(outcomes)} cases in {minutes:.1f} min, {len(failed)} failed; {repeated} were repeated after a pause")
    for outcome in failed:
        print(f"FAILED {outcome['case']}: {'; '.join(outcome['failures'])}\n    {outcome.get('error')}")
    content = {"machine": machine(), "minutes": round(minutes, 1), "figures": figures(outcomes), "cases": outcomes}
    is_whole = len(outcomes) == len(list(cases()))
    if is_whole or arguments.out != FILE:
        arguments.out.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    if is_whole and arguments.out == FILE:
        PAGE.write_text(into_page(PAGE.read_text(encoding="utf-8"), content), encoding="utf-8")
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(main())
