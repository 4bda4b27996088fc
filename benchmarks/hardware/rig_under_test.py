"""Rigs that are tried with faults: those of the examples with shorter ways, their experiment, and an observer.

Speeds, accelerations, wires and their timing are those of the examples but for two of the slow rig: its SHOT talks at
38400 instead of 9600 baud, and its DS102 replies after 5 instead of 50 ms; with ``as_shipped`` they are kept.
"""

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from jam import Jam, JamConfig
from stage_hardware.links.serial_link import POLL_S, STOP_WAITS_S
from stage_hardware.rig.emulated_rig import EmulatedRig
from stage_hardware.rig.rig_config import Emulation, RigConfig, load_rig

EXAMPLES = Path(__file__).resolve().parents[2] / "examples" / "rigs"
LENGTH_UM, GAP_UM = 400.0, 40.0
STOP_MN, LATCH_MN = 1000.0, 3000.0
AXIAL_STOP_MN, AXIAL_LATCH_MN = 5000.0, 9000.0
HARD_MN_UM = 15.0
"""The stiffest wall that is met: at the full speed of the axis its load rises more slowly than is allowed."""

WAKES_S = 0.02
"""What is allowed for threads of a busy machine to be scheduled in, from a reading to a stop."""

SHORTER: Mapping[str, Mapping[str, Mapping[str, str]]] = {
    "shot_ds102": {
        "radial": {"travel": "-1..1 mm", "start": "0.3 mm"},
        "elevator": {"travel": "0..4 mm", "start": "0.6 mm"},
    },
    "pi_venus": {
        "axial": {"travel": "0..4 mm", "start": "0.6 mm"},
        "radial": {"travel": "-1..1 mm", "start": "-0.8 mm", "origin": "-1.1 mm"},
    },
}
PERIODS = {"shot_ds102": "400 ms", "pi_venus": "120 ms"}
SPEEDS = {"shot_ds102": "200 um/s", "pi_venus": "300 um/s"}
AXIAL_CONTROLLER = {"shot_ds102": "elevator", "pi_venus": "axial"}


def rig_config(name: str, folder: Path, *, as_shipped: bool = False) -> RigConfig:
    """Return a rig of the examples with shorter ways, and a contact that can jam."""
    from neurorobo.config import document

    path = folder / "described.yaml"
    content: Any = document.load_document(EXAMPLES / f"{name}.yaml").value
    for controller, changes in SHORTER[name].items():
        for axis in content["controllers"][controller]["axes"].values():
            axis |= changes
    if name == "shot_ds102" and not as_shipped:
        content["controllers"]["radial"]["baud"] = 38400
    del content["emulate"]
    path.write_text(document.dump(content), encoding="utf-8")
    physics = JamConfig(axes=("z",), at=GAP_UM, lateral_mN_um=0.5, axial_mN_um=2.0)
    return load_rig(path).model_copy(update={"emulate": Emulation.model_construct(physics=physics)})


def experiment(name: str, folder: Path, rig: EmulatedRig, *, as_shipped: bool = False, overrun: str = "skip") -> Path:
    """Write rig file and experiment of a rig that is emulated, and return the latter.

    A busy machine is late at times; by default that is no fault.
    """
    rig_path, path = folder / "rig.yaml", folder / "experiment.yaml"
    rig_path.write_text(rig.config.model_copy(update={"emulate": None}).dump(), encoding="utf-8")
    is_slow = as_shipped and name == "shot_ds102"
    period, speed = ("1 s", "100 um/s") if is_slow else (PERIODS[name], SPEEDS[name])
    path.write_text(
        f"""neurorobo: 1
name: faults
seed: 7
time: {{control: {period}, radial: {period}}}
body:
  type: precision.hardware_rig
  rig: {rig_path}
  length: {LENGTH_UM} um
  gap: {GAP_UM} um
  axial_period: {period}
  max_speed: {speed}
  creep_speed: 20 um/s
  max_acceleration: 10 mm/s^2
  stage_resolution: 0.5 um
  elevator_resolution: 1 um
  free_force: 0.2 N
  safety:
    force: {{stop: {STOP_MN} mN, latch: {LATCH_MN} mN, rate: 20 N/s, age: 50 ms}}
    axial_force: {{stop: {AXIAL_STOP_MN} mN, latch: {AXIAL_LATCH_MN} mN}}
  overrun: {overrun}
task: precision.insertion
regions:
  trapezoid: {{type: precision.trapezoid, max_speed: {speed}, max_acceleration: 1 mm/s^2}}
  controller: {{type: precision.pid, kp: 8.0, ki: 0.0, kd: 0.0}}
steps:
  - plan: {{use: trapezoid, remaining: body.remaining, speed: previous plan.speed}}
  - act: {{use: controller, every: radial, force: body.force}}
command: {{axial_speed: plan.speed, radial_move: act.move}}
record: [trajectory]
""",
        encoding="utf-8",
    )
    return path


def emulated(config: RigConfig, *, as_shipped: bool = False) -> EmulatedRig:
    """Return the emulators of a rig."""
    rig = EmulatedRig(config)
    if not as_shipped and "elevator" in rig.controllers:
        rig.controllers["elevator"].emulator.wire.processing_s = 0.005
    return rig


@dataclass(frozen=True)
class Allowance:
    """How long a rig may go on after a reading beyond a limit, term by term, and how far that lets the load rise.

    ``link_s`` is what a stop lets a transaction end by itself, ``line_s`` its bytes on the line, and ``controller_s``
    what the controller takes for the replies that it is sending just then, as an emulator hears nothing meanwhile.
    """

    sensor_s: float
    wakes_s: float
    link_s: float
    line_s: float
    controller_s: float
    speed_um_s: float
    brakes_um: float

    @property
    def stops_s(self) -> float:
        """From a trip to standstill, the way of braking aside."""
        return self.wakes_s + self.link_s + self.line_s + self.controller_s

    def load_mN(self, stiffness_mN_um: float) -> float:
        """By how much the load can be beyond the limit when everything stands."""
        return stiffness_mN_um * (self.speed_um_s * (self.sensor_s + self.stops_s) + self.brakes_um)


def allowance(name: str, *, as_shipped: bool = False) -> Allowance:
    """Return that of a rig's axial controller: `STOP 0` of the DS102 and `#24` of PI stop without a ramp.

    A DS102 replies to 10 characters at most, at 38400 baud; PI over TCP takes no time on the line, and is asked for
    three replies at once.
    """
    slow = name == "shot_ds102"
    processing_s = (0.05 if as_shipped else 0.005) if slow else 3 * 0.0005
    return Allowance(
        sensor_s=0.002,
        wakes_s=WAKES_S,
        link_s=STOP_WAITS_S + POLL_S,
        line_s=7 * 10 / 38400 if slow else 0.0,
        controller_s=processing_s + (10 * 10 / 38400 if slow else 0.0),
        speed_um_s=1000.0,
        brakes_um=0.0,
    )


@dataclass
class Observer:
    """Looks at all mechanisms every ms, in a thread, and throws a switch when a phase is reached.

    ``axes`` are those whose motion it waits for, ``begun`` the periods that the loop has begun; ``moved`` keeps, for
    each look, its time, the axes that moved, the axial position and whether it went back. ``longest_pause_ms`` is how
    long this process got no processor at worst, as far as one thread can tell.
    """

    rig: EmulatedRig
    phase: str
    axes: tuple[str, ...]
    inject: Callable[[], None]
    begun: int = 0
    injected_ns: int | None = None
    jammed_ns: int | None = None
    longest_pause_ms: float = 0.0
    moved: list[tuple[int, tuple[str, ...], float, bool]] = field(default_factory=list)
    error: str | None = None

    def __post_init__(self) -> None:
        """Prepare it."""
        self.mechanisms = {
            name: axis.mechanism for stage in self.rig.controllers.values() for name, axis in stage.axes.items()
        }
        self._homed: set[str] = set()
        self._went_back = False
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="observer", daemon=True)

    def __enter__(self) -> "Observer":
        """Begin to look."""
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """End."""
        self._ends.set()
        self._thread.join()

    def moving(self) -> tuple[str, ...]:
        """Return the axes that move."""
        return tuple(name for name, mechanism in self.mechanisms.items() if mechanism.velocity != 0)

    def _watch(self) -> None:
        try:
            while not self._ends.wait(0.001):
                self._look()
        except Exception as error:  # it is told where the case is judged
            self.error = repr(error)

    def _look(self) -> None:
        moving = self.moving()
        axial_um, goes_back = self.rig.positions()["z"], self.mechanisms["z"].velocity < 0
        now_ns = time.monotonic_ns()
        if self.moved:
            self.longest_pause_ms = max(self.longest_pause_ms, (now_ns - self.moved[-1][0]) / 1e6)
        self.moved.append((now_ns, moving, axial_um, goes_back))
        for name, mechanism in self.mechanisms.items():
            if name not in moving and abs(mechanism.position) < 1e-6:
                self._homed.add(name)
        if self.injected_ns is None and self._is_reached(moving, goes_back):
            self.inject()
            self.injected_ns = time.monotonic_ns()

    def _is_reached(self, moving: tuple[str, ...], goes_back: bool) -> bool:
        if self.phase == "loop":
            return self.begun > 2
        moves = bool(set(self.axes) & set(moving))
        if self.phase == "homing":
            return moves and not set(self.axes) & self._homed
        all_homed = self._homed == set(self.mechanisms)
        if self.phase == "approach":
            return moves and all_homed and self.begun == 0
        inserts = self.begun > 2 and self.rig.positions()["z"] > GAP_UM + 60
        if self.phase == "insertion":
            return moves and inserts
        if self.jammed_ns is None and inserts and "z" in moving:
            self.jammed_ns = time.monotonic_ns()
            physics: Jam = self.rig.physics  # type: ignore[assignment]
            physics.step(1500.0)
        self._went_back = self._went_back or (self.jammed_ns is not None and goes_back)
        return self._went_back and moves
