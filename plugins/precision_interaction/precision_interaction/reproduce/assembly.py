"""Fig. 11 to 13 and Table I: the assembly, by the brain and by the two methods that the paper compares it with."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from neurorobo.config.experiment import Experiment, load_experiment
from neurorobo.experiment.build import build_brain, build_task
from neurorobo.experiment.closed_loop import run_episodes
from neurorobo.experiment.recorder import Recorder, Sample
from neurorobo.experiment.recorder import Setting as RunSetting
from neurorobo.experiment.weights import weights_file
from precision_interaction.reproduce.row import Result, Row, Setting

if TYPE_CHECKING:
    pass

SEEDS, QUICK_SEEDS = range(100), range(2)
DEPTH_GAIN = "body.contact.depth_gain=1"
TRACE_SEED = 0


@dataclass(frozen=True)
class Case:
    """A controller on a rig: what is changed in which example, the paper's figures, the ideal, and what is wanted."""

    file: str
    changes: tuple[str, ...] = ()
    paper: str = "-"
    ideal: str = "-"
    wanted: tuple[float, float, float] | None = None


FINE = ("body.contact.law=proportional", "body.stage_resolution=0.1 um")
ZIEGLER_NICHOLS = tuple(f"regions.controller.{gain}" for gain in ("kp=1.2", "ki=1.2", "kd=0.3"))
CASES = {
    "brain, paper rig": Case("peg_in_hole", (), "28 / 25 / 50", "26.0 / 21.7 / 47.0", (27, 23, 50)),
    "brain, paper rig with depth gain": Case("peg_in_hole", (DEPTH_GAIN,)),
    "brain, fine rig, 1 Hz": Case("peg_in_hole", FINE, ideal="26.0 / 11.4 / 39"),
    "brain, fine rig, 5 Hz": Case("peg_in_hole_fast", (), ideal="26.0 / 5.9 / 17.7"),
    "brain, fine rig, 20 Hz": Case(
        "peg_in_hole_fast", ("time.radial=50 ms",), ideal="26.0 / 4.6 / 13.2", wanted=(27, 6, 16)
    ),
    "teachers, paper rig": Case("peg_in_hole_teachers", (), ideal="26.0 / 21.7 / 47.0"),
    "teachers, paper rig, profile": Case(
        "peg_in_hole_teachers", ("regions.cerebellum.type=precision.profile",), ideal="26.0 / 20.1 / 43.5"
    ),
    "force-based, ref. [3]": Case("baseline_force_based", (), "103 / - / ~100", "103 / 18.5 / 58"),
    "force-based, with depth gain": Case("baseline_force_based", (DEPTH_GAIN,), "103 / - / ~100"),
    "model-based, ref. [7]": Case("baseline_model_based", (), "26 / 78 / 160", "25 / 85 / 127"),
    "PID, grid search": Case("baseline_pid"),
    "PID, Ziegler-Nichols": Case("baseline_pid", ZIEGLER_NICHOLS),
}
TRACED = {
    "fig11": ("brain, paper rig", "Fig. 11"),
    "fig12": ("force-based, ref. [3]", "Fig. 12"),
    "fig13": ("model-based, ref. [7]", "Fig. 13"),
}
METRICS = {"steps": "steps", "mean_force_mN": "mean force, mN", "max_force_mN": "largest force, mN"}


class Trace(Recorder):
    """Keeps what the paper's figures show, of the first episode."""

    def __init__(self, setting: RunSetting) -> None:
        super().__init__(setting)
        self.rows: list[list[float]] = []

    def sample(self, sample: Sample) -> None:
        """Keep time, distance left, commanded axial speed, force x and y, and radial move x and y."""
        if sample.running[0]:
            remaining, force = sample.observation["remaining"][0], sample.observation["force"][0]
            speed, move = sample.given["axial_speed"][0], sample.given["radial_move"][0]
            self.rows.append([sample.time_s, *(float(x) for x in (*remaining, *speed, *force, *move))])

    def finish(self) -> None:
        """Nothing is written."""


class Assembly(Row):
    """Time and force of the insertion, over 100 seeds."""

    name: ClassVar[str] = "assembly"

    def cells(self, setting: Setting) -> Sequence[str]:
        """Return the names of the cases."""
        return list(CASES)

    def files(self, setting: Setting) -> Sequence[Path]:
        """Return the examples and the shipped weights."""
        experiments = [self._experiment(case, setting) for case in CASES.values()]
        weights = {
            weights_file(name, experiment)
            for experiment in experiments
            for name, config in experiment.regions.items()
            if config.weights
        }
        return [*sorted(weights), *sorted({setting.examples / f"{case.file}.yaml" for case in CASES.values()})]

    def measure(self, cell: str, setting: Setting) -> Result:
        """Insert once per seed, side by side."""
        experiment = self._experiment(CASES[cell], setting)
        brain, task = build_brain(experiment), build_task(experiment)
        assert task is not None
        seeds = QUICK_SEEDS if setting.quick else SEEDS
        episodes = run_episodes(brain, task, seeds)
        names = ("success", "final_error_um", "overshoot_um", "command_interventions", *METRICS)
        found: dict[str, object] = {name: [float(episode.metrics[name]) for episode in episodes] for name in names}
        if cell in {case for case, _ in TRACED.values()}:
            trace = Trace(RunSetting(Path(), experiment.name, brain.plan, [TRACE_SEED], task))
            run_episodes(brain, task, [TRACE_SEED], recorders=[trace])
            found["trace"] = np.round(trace.rows, 4).tolist()
        return found

    def _experiment(self, case: Case, setting: Setting) -> Experiment:
        return load_experiment(setting.examples / f"{case.file}.yaml", case.changes)
