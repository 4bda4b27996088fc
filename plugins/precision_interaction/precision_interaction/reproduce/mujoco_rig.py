"""A rig that nobody here wrote the contact of: MuJoCo's is identified, learned, and inserted into."""

import tempfile
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from neurorobo.bodies import Array
from neurorobo.config.experiment import Experiment, load_experiment
from neurorobo.experiment.build import build_brain, build_task
from neurorobo.experiment.closed_loop import run_episodes
from neurorobo.experiment.lessons import read_lessons
from neurorobo.experiment.train import train_experiment
from neurorobo.experiment.weights import weights_file
from neurorobo.plugins import Registry
from precision_interaction.identification.analysis import analyse
from precision_interaction.identification.experiment import insert_and_withdraw
from precision_interaction.identification.fragment import contact_of
from precision_interaction.reproduce.row import Result, Row, Setting
from precision_interaction.rig.identified_law_config import IdentifiedLawConfig
from precision_interaction.rig.mujoco_rig import MujocoRig
from precision_interaction.rig.mujoco_rig_config import MujocoRigConfig

EXAMPLE, TEACHERS = "peg_in_hole_mujoco.yaml", "peg_in_hole_teachers.yaml"
IDENTIFICATION, TEACHERS_RUN, SHIPPED, TRAINED = "identification", "teachers", "shipped brain", "trained brain"
REGION = "hippocampus"

REPETITIONS, QUICK_REPETITIONS = 400, 10
DEPTH_UM = 50.0
IDENTIFICATION_SEED = 1000
SEEDS, QUICK_SEEDS = range(20), range(2)
METRICS = ("steps", "mean_force_mN", "max_force_mN", "success", "final_error_um", "overshoot_um")
PROBE_UM = 1.0
SECOND_NS = 1_000_000_000


class MujocoInsertion(Row):
    """What is identified on the rig, and insertions on it: by teachers of that law, and by the brain before and after.

    The teachers and the trained brain know the contact that the example's file holds; the identification tells whether
    that is what is found. Of the brain, the hippocampus alone is trained anew.
    """

    name: ClassVar[str] = "mujoco"

    def cells(self, setting: Setting) -> Sequence[str]:
        """Return the identification and the controllers."""
        return (IDENTIFICATION, TEACHERS_RUN, SHIPPED, TRAINED)

    def files(self, setting: Setting) -> Sequence[Path]:
        """Return the examples and the shipped weights."""
        experiment = _experiment(setting)
        weights = {weights_file(name, experiment) for name, config in experiment.regions.items() if config.weights}
        return [setting.examples / EXAMPLE, setting.examples / TEACHERS, *sorted(weights)]

    def measure(self, cell: str, setting: Setting) -> Result:
        """Identify, or insert once per seed; the trained brain is trained first."""
        if cell == IDENTIFICATION:
            return _identify(setting)
        if cell == TEACHERS_RUN:
            return _insert(_taught_by_teachers(setting), setting)
        if cell == SHIPPED:
            return _insert(_experiment(setting), setting)
        with tempfile.TemporaryDirectory() as folder:
            report = _train(Path(folder), setting)
            trained = f"regions.{REGION}.weights={Path(folder) / REGION}.safetensors"
            return {**_insert(_experiment(setting, trained), setting), **report}


def _experiment(setting: Setting, *changes: str) -> Experiment:
    return load_experiment(setting.examples / EXAMPLE, changes)


def _body(setting: Setting) -> MujocoRigConfig:
    body = _experiment(setting).body
    assert isinstance(body, MujocoRigConfig)
    return body


def _identify(setting: Setting) -> Result:
    """Log and analyse as `neurorobo identify` does, and probe the stiffness."""
    body = _body(setting)
    filtered = body.model_copy(update={"force_resolution": 0.0})
    repetitions = QUICK_REPETITIONS if setting.quick else REPETITIONS
    found = analyse(insert_and_withdraw(filtered, repetitions=repetitions, seed=IDENTIFICATION_SEED, depth_um=DEPTH_UM))
    assert found.measured is not None
    assert body.contact is not None
    stiffness = _stiffness_mN_um(body, repetitions)
    return {
        "repetitions": repetitions,
        "step_um": found.step_um.tolist(),
        "mean_mN": found.mean_mN.tolist(),
        "variance_mN2": found.variance_mN2.tolist(),
        "r_squared": found.radial_r_squared.tolist(),
        "line_r_squared": {
            name: _r_squared(line.at(found.step_um), values)
            for name, line, values in (
                ("mean", found.proportional.mean, found.mean_mN),
                ("variance", found.proportional.variance, found.variance_mN2),
            )
        },
        "fits": {
            fit.law: {
                name: {key: np.asarray(value).tolist() for key, value in asdict(line).items()}
                for name, line in (("mean", fit.mean), ("variance", fit.variance))
            }
            for fit in (found.measured, found.proportional)
        },
        "contact": contact_of(found, found.best()).model_dump(mode="json"),
        "in_the_file": body.contact.model_dump(mode="json"),
        "stiffness_mN_um": {"mean": stiffness.mean(0).tolist(), "deviation": stiffness.std(0, ddof=1).tolist()},
    }


def _r_squared(line: Array, values: Array) -> list[float]:
    """Return the share of the variation over the steps that a line explains, of each axis."""
    return list(1.0 - ((values - line) ** 2).sum(0) / ((values - values.mean(0)) ** 2).sum(0))


def _stiffness_mN_um(config: MujocoRigConfig, bodies: int) -> Array:
    """Return what a radial move of 1 um in the hole takes off the force along it, (bodies, 2), at standstill."""
    rig = MujocoRig(config)
    rig.reset([IDENTIFICATION_SEED + i for i in range(bodies)])
    still = np.zeros((bodies, 1))
    rig.advance({"axial_speed": np.full((bodies, 1), config.gap + DEPTH_UM)}, SECOND_NS)
    rig.advance({"axial_speed": still}, SECOND_NS)
    found = []
    for axis in range(2):
        before_mN = rig.force_mN[:, axis]
        move = np.zeros((bodies, 2))
        move[:, axis] = PROBE_UM
        rig.advance({"axial_speed": still, "radial_move": move}, SECOND_NS)
        found.append((before_mN - rig.force_mN[:, axis]) / PROBE_UM)
    return np.stack(found, axis=1)


def _taught_by_teachers(setting: Setting) -> Experiment:
    """Return the teachers' graph on the rig, its hippocampus the law that was identified."""
    body = _body(setting)
    assert body.contact is not None
    experiment = load_experiment(setting.examples / TEACHERS)
    regions = {**experiment.regions, REGION: IdentifiedLawConfig(contact=body.contact)}
    return experiment.model_copy(update={"body": body, "regions": regions})


def _train(folder: Path, setting: Setting) -> dict[str, Any]:
    """Train the hippocampus as `neurorobo train` does with the example; return its errors."""
    registry = Registry.discover()
    experiment = load_experiment(setting.examples / EXAMPLE, registry=registry)
    if setting.quick:
        phases = [phase.model_copy(update={"steps": 2}) for phase in experiment.train]
        experiment = experiment.model_copy(update={"train": tuple(phases)})
    reports = train_experiment(experiment, read_lessons(experiment, registry), folder, only=[REGION])
    return {"rms": reports[-1].evaluation["rms"]}


def _insert(experiment: Experiment, setting: Setting) -> dict[str, Any]:
    episodes = run_episodes(build_brain(experiment), build_task(experiment), QUICK_SEEDS if setting.quick else SEEDS)
    return {name: [float(episode.metrics[name]) for episode in episodes] for name in METRICS}
