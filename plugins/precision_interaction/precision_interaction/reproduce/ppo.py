"""Eq. 13: the joined brain, fine-tuned by PPO on the cost of Eq. 3."""

import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from neurorobo.config.experiment import Experiment, load_experiment
from neurorobo.experiment.lessons import read_lessons
from neurorobo.experiment.plan import build_plan
from neurorobo.experiment.practice import Practice
from neurorobo.experiment.train import train_experiment
from neurorobo.experiment.weights import weights_file
from neurorobo.plugins import Registry
from precision_interaction.reproduce.row import Result, Row, Setting

EXAMPLE, IDEAL = "peg_in_hole_ppo.yaml", "peg_in_hole_teachers.yaml"
SEEDS, QUICK_SEEDS = range(100), range(2)
PAPER_RIG, DEEP_RIG = "paper rig", "paper rig with depth gain"
DEPTH_GAIN = {DEEP_RIG: 1.0, PAPER_RIG: 0.0}
OTHER = {PAPER_RIG: DEEP_RIG, DEEP_RIG: PAPER_RIG}


@dataclass(frozen=True)
class Training:
    """One training: the rig, the weight of the force in Eq. 3 and 13, and the seed."""

    rig: str
    seed: int
    force_weight: float = 1.0

    @property
    def name(self) -> str:
        """The name of the cell."""
        return f"{self.rig}, gamma_f {self.force_weight:g}, seed {self.seed}"


@dataclass(frozen=True)
class Ideal:
    """Analytic controllers that know the contact of the paper's rig and go no faster than this, on one rig."""

    rig: str
    speed_um_s: int

    @property
    def name(self) -> str:
        """The name of the cell."""
        return f"ideal, {self.rig}, {self.speed_um_s} um/s"


FIRST_SEED = 2  # with seed 1 the settings were chosen
SEEDED = [Training(rig, seed) for rig in DEPTH_GAIN for seed in range(FIRST_SEED, FIRST_SEED + 5)]
WEIGHTED = [Training(DEEP_RIG, FIRST_SEED, force_weight) for force_weight in (0.25, 0.5, 2.0, 4.0)]
TRAININGS = {training.name: training for training in (*SEEDED, *WEIGHTED)}
QUICK_TRAININGS = (Training(DEEP_RIG, FIRST_SEED), Training(PAPER_RIG, FIRST_SEED), WEIGHTED[0])
IDEALS = {ideal.name: ideal for ideal in (Ideal(rig, speed) for rig in DEPTH_GAIN for speed in (100, 80, 60, 40, 30))}
SHIPPED = {f"as shipped, {rig}": rig for rig in DEPTH_GAIN}
QUICK = ("iterations=1", "episodes=1", "validation={episodes: 1}", "held_out={episodes: 2}")


def trainings(setting: Setting) -> Sequence[Training]:
    """Return the trainings that are measured."""
    return QUICK_TRAININGS if setting.quick else list(TRAININGS.values())


class Ppo(Row):
    """What the insertions cost before and after training, on two rigs, for several seeds and weights of the force."""

    name: ClassVar[str] = "ppo"

    def cells(self, setting: Setting) -> Sequence[str]:
        """Return the trainings, and what they are compared with."""
        return [*(training.name for training in trainings(setting)), *SHIPPED, *IDEALS]

    def files(self, setting: Setting) -> Sequence[Path]:
        """Return the examples and the shipped weights."""
        experiment = load_experiment(setting.examples / EXAMPLE)
        weights = [weights_file(name, experiment) for name, config in experiment.regions.items() if config.weights]
        return [*(setting.examples / name for name in (EXAMPLE, IDEAL)), *weights]

    def measure(self, cell: str, setting: Setting) -> Result:
        """Train and insert, or only insert; of a training, the times alone differ from run to run."""
        seeds = QUICK_SEEDS if setting.quick else SEEDS
        if cell in SHIPPED:
            return _whole_and_parts(EXAMPLE, [_rig(SHIPPED[cell])], setting, seeds)
        if cell in IDEALS:
            return _ideal(IDEALS[cell], setting, seeds)
        return _train(TRAININGS[cell], setting, seeds)


def _train(training: Training, setting: Setting, seeds: Sequence[int]) -> Result:
    """Return how a training went, what it gained on its own rig, and what it makes of the other one."""
    registry = Registry.discover()
    changes = [f"task.force_weight={training.force_weight}", f"train.0.seed={training.seed}"]
    changes += [f"train.0.{change}" for change in QUICK] if setting.quick else []
    experiment = load_experiment(setting.examples / EXAMPLE, [*changes, _rig(training.rig)], registry)
    started_s, seconds = time.process_time(), list[float]()
    with tempfile.TemporaryDirectory() as folder:
        [report] = train_experiment(
            experiment,
            read_lessons(experiment, registry),
            Path(folder),
            report=lambda index, progress: seconds.append(round(time.process_time() - started_s, 1)),
        )
        trained = [f"regions.{name}.weights={folder}/{name}.safetensors" for name in report.regions]
        there = load_experiment(setting.examples / EXAMPLE, [*changes, _rig(OTHER[training.rig]), *trained], registry)
        other_rig = _practice(there).perform(seeds).to_json()
        plain = [*changes, _rig(training.rig), *trained]
        parts = _parts(report.evaluation["held_out"]["after"], EXAMPLE, plain, training.force_weight, setting, seeds)
        return {**report.evaluation, "seconds": seconds, "other_rig": other_rig, "parts": parts}


def _rig(name: str) -> str:
    return f"body.contact.depth_gain={DEPTH_GAIN[name]}"


def _ideal(ideal: Ideal, setting: Setting, seeds: Sequence[int]) -> Result:
    """Return what analytic controllers do and what it costs, in both parts of Eq. 3."""
    speed = f"regions.prefrontal_cortex.max_speed={ideal.speed_um_s} um/s"
    return _whole_and_parts(IDEAL, ["regions.hippocampus.law=measured", speed, _rig(ideal.rig)], setting, seeds)


def _whole_and_parts(example: str, changes: Sequence[str], setting: Setting, seeds: Sequence[int]) -> Result:
    """Return what the insertions of an example are like at gamma_f 1, and both parts of what they cost."""
    whole = _practice(load_experiment(setting.examples / example, changes)).perform(seeds).to_json()
    return {**whole, **_parts(whole, example, changes, 1.0, setting, seeds)}


def _parts(
    whole: Result, example: str, changes: Sequence[str], force_weight: float, setting: Setting, seeds: Sequence[int]
) -> Result:
    """Return both parts of the returns of ``whole``: of the distance, and of the force at gamma_f 1.

    The insertions are the same as those of ``whole``, as the weight of the force changes only what they cost.
    """
    experiment = load_experiment(setting.examples / example, [*changes, "task.force_weight=0"])
    distance = _practice(experiment).perform(seeds).to_json()["return"]
    force = [(both - one) / force_weight for both, one in zip(whole["return"], distance, strict=True)]
    return {"distance_return": distance, "force_return": force}


def _practice(experiment: Experiment) -> Practice:
    return Practice(experiment, build_plan(experiment), (), {})
