"""What the brain learns while it inserts, on rigs that differ from what it was trained for, and what it forgets."""

import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch

from neurorobo.bodies import Array
from neurorobo.config.experiment import Experiment, load_experiment
from neurorobo.experiment.build import build_brain, build_task
from neurorobo.experiment.closed_loop import LARGEST_BATCH, run_episodes
from neurorobo.experiment.lessons import read_lessons
from neurorobo.experiment.memory import Memory
from neurorobo.experiment.recorder import Recorder, Sample
from neurorobo.experiment.recorder import Setting as RunSetting
from neurorobo.experiment.train import train_experiment
from neurorobo.experiment.weights import weights_file
from neurorobo.graph.brain import Brain
from neurorobo.plugins import Registry
from neurorobo.tasks.task import Task
from precision_interaction.reproduce.row import Result, Row, Setting
from precision_interaction.rig.insertion_rig import InsertionRig

SEEDS, QUICK_SEEDS = 100, 2
"""How many sessions; insertion i, from 0, of session s has the seed s + 10 000 i: no setting was chosen on those."""

SEED_STRIDE = 10_000

METRICS = ("mean_force_mN", "max_force_mN", "steps", "success")
CHANGE_AT_UM = 1000.0
SOFT_MN_UM, STIFF_MN_UM = 80.0, 120.0
PERIODS_BEFORE, PERIODS_AFTER = 5, 7
"""Axial periods around the change, while the speed is the largest one all the time."""

TWENTY_HZ = 'time.radial="50 ms"'
STIFFER = f"body.stiffness_change={{at: {CHANGE_AT_UM:g} um, to: {STIFF_MN_UM:g} mN/um}}"
IDEAL = ("body.contact.law=proportional", "body.stage_resolution=0.1 um", TWENTY_HZ)
PRIOR_LAW = "body.contact.law=proportional"
TRUE_LAW = "{type: precision.law, law: measured}"


@dataclass(frozen=True)
class Stretch:
    """So many insertions in a row on one rig: what is changed in the example."""

    insertions: int
    changes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Session:
    """Stretches in a row, with one memory; ``taught`` trains the hippocampus on the true law first.

    What does not learn needs no row: ``number`` is the number of its first insertion, counted from 0.
    """

    file: str
    stretches: tuple[Stretch, ...]
    changes: tuple[str, ...] = ()
    taught: bool = False
    number: int = 0


def _compensator(stiffness_mN_um: float) -> str:
    return (
        "regions.cerebellum={type: precision.predictive, max_acceleration: 200 um/s^2, "
        f"stiffness: {stiffness_mN_um:g} mN/um}}"
    )


INSERTIONS = 10
SESSIONS = {
    "fine rig, learning": Session("peg_in_hole_fast_adaptive", (Stretch(1, (STIFFER,)), Stretch(3)), (TWENTY_HZ,)),
    "fine rig, as shipped": Session("peg_in_hole_fast", (Stretch(1, (STIFFER,)), Stretch(1)), (TWENTY_HZ,)),
    "paper rig, learning": Session("peg_in_hole_adaptive", (Stretch(INSERTIONS), Stretch(2, (PRIOR_LAW,)), Stretch(1))),
    "paper rig, as shipped": Session("peg_in_hole", (Stretch(1), Stretch(2, (PRIOR_LAW,))), number=INSERTIONS - 1),
    "paper rig, trained on its law": Session("peg_in_hole", (Stretch(1),), taught=True, number=INSERTIONS - 1),
    "fine rig, ideal": Session("peg_in_hole_teachers", (Stretch(1, (STIFFER,)),), (*IDEAL, _compensator(SOFT_MN_UM))),
    "fine rig, ideal, told": Session(
        "peg_in_hole_teachers",
        (Stretch(1, (f"body.stiffness={STIFF_MN_UM:g} mN/um", STIFFER)),),
        (*IDEAL, _compensator(STIFF_MN_UM)),
    ),
}
"""Told is the ideal controller on a rig that is stiff from the start."""

OFF = {
    "peg_in_hole": ("peg_in_hole_adaptive", ()),
    "peg_in_hole_fast": ("peg_in_hole_fast_adaptive", (TWENTY_HZ, STIFFER)),
}
"""Examples that must give the same with learning switched off: the one with learning, and what is changed in both."""

TIMED = {"learning": "peg_in_hole_fast_adaptive", "as shipped": "peg_in_hole_fast"}


class Forces(Recorder):
    """Keeps the true radial force at the end of every radial period, and the travel at its start, while it runs."""

    def __init__(self, setting: RunSetting) -> None:
        super().__init__(setting)
        self.force_mN: list[Array] = []
        self.travel_um: list[Array] = []

    def sample(self, sample: Sample) -> None:
        """Keep one period; of episodes that have ended, nothing."""
        assert self.setting.task is not None and isinstance(self.setting.task.body, InsertionRig)
        force_mN = np.linalg.norm(self.setting.task.body.force_mN[:, :2], axis=1)
        self.force_mN.append(np.where(sample.running, force_mN, np.nan))
        self.travel_um.append(np.where(sample.running, sample.observation["travel"][:, 0], np.nan))

    def finish(self) -> None:
        """Nothing is written."""

    def around_the_change(self, per_axial: int) -> list[list[float]]:
        """Return each episode's mean forces in the axial periods around the change, counted from it."""
        means = []
        for force_mN, travel_um in zip(np.array(self.force_mN).T, np.array(self.travel_um).T, strict=True):
            changed = int(np.argmax(travel_um >= CHANGE_AT_UM))
            start, stop = changed - PERIODS_BEFORE * per_axial, changed + PERIODS_AFTER * per_axial
            means.append(np.round(force_mN[start:stop].reshape(-1, per_axial).mean(1), 3).tolist())
        return means


class Adaptation(Row):
    """Sessions of insertions in a row, with and without learning."""

    name: ClassVar[str] = "adaptation"

    def cells(self, setting: Setting) -> Sequence[str]:
        """Return the sessions, and two further questions."""
        return [*SESSIONS, "learning off", "control period"]

    def files(self, setting: Setting) -> Sequence[Path]:
        """Return the examples and the shipped weights."""
        experiments = [_experiment(session.file, session.changes, setting) for session in SESSIONS.values()]
        weights = {
            weights_file(name, experiment)
            for experiment in experiments
            for name, config in experiment.regions.items()
            if config.weights
        }
        examples = {session.file for session in SESSIONS.values()} | {"peg_in_hole"}
        return [*sorted(weights), *(setting.examples / f"{name}.yaml" for name in sorted(examples))]

    def measure(self, cell: str, setting: Setting) -> Result:
        """Measure one cell; but for the times of the control period, deterministic."""
        if cell == "learning off":
            return {example: _same_without_learning(example, setting) for example in OFF}
        if cell == "control period":
            return {name: _milliseconds(example, setting) for name, example in TIMED.items()}
        session = SESSIONS[cell]
        with tempfile.TemporaryDirectory() as folder:
            changes = session.changes
            if session.taught:
                changes = (*changes, f"regions.hippocampus.weights={_taught(Path(folder), setting)}")
            return _run(session, changes, setting)


def _experiment(file: str, changes: Sequence[str], setting: Setting) -> Experiment:
    return load_experiment(setting.examples / f"{file}.yaml", changes)


def _built(experiment: Experiment) -> tuple[Brain, Task[Any]]:
    task = build_task(experiment)
    assert task is not None
    return build_brain(experiment), task


def _run(session: Session, changes: Sequence[str], setting: Setting) -> Result:
    """Run all sessions, some side by side; the lists over insertions hold a number for each session."""
    sessions = QUICK_SEEDS if setting.quick else SEEDS
    rigs = []
    for stretch in session.stretches:
        experiment = _experiment(session.file, (*changes, *stretch.changes), setting)
        rigs.append((experiment, *_built(experiment)))
    counts = [min(stretch.insertions, 2) if setting.quick else stretch.insertions for stretch in session.stretches]
    found: list[list[dict[str, list[float]]]] = [[{} for _ in range(count)] for count in counts]
    around: list[list[float]] = []
    for batch in _batches(sessions):
        memory, number = Memory(), session.number
        for stretch, (experiment, brain, task), results in zip(session.stretches, rigs, found, strict=True):
            for result in results:
                forces = Forces(RunSetting(Path(), experiment.name, brain.plan, batch, task))
                seeds = [seed + SEED_STRIDE * number for seed in batch]
                episodes = run_episodes(brain, task, seeds, recorders=[forces], memory=memory)
                for metric in METRICS:
                    result.setdefault(metric, []).extend(round(episode.metrics[metric], 3) for episode in episodes)
                if STIFFER in stretch.changes:
                    periods = experiment.clock.periods_ns
                    around += forces.around_the_change(periods["control"] // periods["radial"])
                number += 1
    return {"stretches": found, "around": around}


def _batches(sessions: int) -> list[range]:
    return [range(sessions)[first : first + LARGEST_BATCH] for first in range(0, sessions, LARGEST_BATCH)]


def _taught(folder: Path, setting: Setting) -> Path:
    """Train the hippocampus as the example does, but on the law of the rig; return its weights."""
    example = setting.examples / "peg_in_hole.yaml"
    registry = Registry.discover()
    plain = load_experiment(example, registry=registry)
    lessons = [i for i, lesson in enumerate(read_lessons(plain, registry)) if "hippocampus" in lesson.pupils]
    experiment = load_experiment(example, [f"train.{i}.teacher={TRUE_LAW}" for i in lessons], registry)
    if setting.quick:
        phases = [phase.model_copy(update={"steps": 2, "batch": 4}) for phase in experiment.train]
        experiment = experiment.model_copy(update={"train": tuple(phases)})
    train_experiment(experiment, read_lessons(experiment, registry), folder, only=["hippocampus"])
    return folder / "hippocampus.safetensors"


def _same_without_learning(example: str, setting: Setting) -> Mapping[str, int]:
    """Return of how many insertions all forces and travels are the same, to the last bit, as without plasticity."""
    adaptive, changes = OFF[example]
    off = [
        f"regions.{name}.{rate}=0"
        for name, config in _experiment(adaptive, changes, setting).regions.items()
        for rate in ("learning_rate", "variance_learning_rate")
        if rate in type(config).model_fields
    ]
    plain, without = (
        _courses(_experiment(file, (*changes, *more), setting), QUICK_SEEDS if setting.quick else SEEDS)
        for file, more in ((example, ()), (adaptive, off))
    )
    same = [np.array_equal(one, other) for one, other in zip(plain, without, strict=True)]
    return {"same": sum(same), "of": len(same)}


def _courses(experiment: Experiment, insertions: int) -> list[Array]:
    """Return force and travel of each insertion, (2, periods until it ends)."""
    brain, task = _built(experiment)
    courses = []
    for seeds in _batches(insertions):
        kept = Forces(RunSetting(Path(), experiment.name, brain.plan, seeds, task))
        run_episodes(brain, task, seeds, recorders=[kept])
        both = np.array([kept.force_mN, kept.travel_um]).transpose(2, 0, 1)
        courses += [course[:, ~np.isnan(course[0])] for course in both]
    return courses


def _milliseconds(example: str, setting: Setting) -> Mapping[str, float]:
    """Return the wall time of one rig's radial periods at 20 Hz: those that plan, and the others."""
    brain, task = _built(_experiment(example, (TWENTY_HZ,), setting))
    starts: list[float] = []
    run_episodes(brain, task, [0], progress=lambda tick, running: starts.append(time.perf_counter()))
    taken_ms = 1e3 * np.diff(starts)[20:]
    plans = np.arange(20, 20 + len(taken_ms)) % 20 == 0
    return {
        "planning": float(np.median(taken_ms[plans])),
        "others": float(np.median(taken_ms[~plans])),
        "longest": float(taken_ms.max()),
        "threads": torch.get_num_threads(),
    }
