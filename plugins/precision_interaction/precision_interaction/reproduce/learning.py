"""How fast the three regions learn from scratch, as `neurorobo train examples/peg_in_hole.yaml` teaches them."""

import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import torch

from neurorobo.config.experiment import Experiment, load_experiment
from neurorobo.experiment.lessons import Lesson, read_lessons
from neurorobo.experiment.train import train_experiment
from neurorobo.learning.supervise import Progress
from neurorobo.plugins import Registry
from precision_interaction.reproduce.row import Result, Row, Setting

EXAMPLE = "peg_in_hole.yaml"
REGIONS = ("hippocampus", "cerebellum", "prefrontal_cortex")
POINTS = 60
"""Points of a phase's curve; each is the mean over the steps since the one before."""


@dataclass
class Curve:
    """The errors of a phase: ``points`` hold processor seconds and the rms error of each output since the last one."""

    started_s: float
    steps: int = 0
    points: list[dict[str, float]] = field(default_factory=list)
    _squares: dict[str, float] = field(default_factory=dict)
    _count: int = 0

    def add(self, progress: Progress) -> None:
        """Take note of a step."""
        self.steps, self._count = progress.steps, self._count + 1
        for name, error in progress.error.items():
            self._squares[name] = self._squares.get(name, 0.0) + error**2
        if self._count >= progress.steps / POINTS or progress.done == progress.steps:
            errors = {name: round((square / self._count) ** 0.5, 4) for name, square in self._squares.items()}
            self.points.append({"seconds": round(time.process_time() - self.started_s, 2), **errors})
            self._squares, self._count = {}, 0


class Learning(Row):
    """The errors of each region while it trains, with its shipped seed, against the time that this takes."""

    name: ClassVar[str] = "learning"

    def cells(self, setting: Setting) -> Sequence[str]:
        """Return the regions."""
        return REGIONS

    def files(self, setting: Setting) -> Sequence[Path]:
        """Return the example."""
        return [setting.examples / EXAMPLE]

    def measure(self, cell: str, setting: Setting) -> Result:
        """Train one region through all of its phases; only the times differ from run to run."""
        experiment, lessons = _read(setting)
        curves: dict[int, Curve] = {}
        threads = torch.get_num_threads()

        def follow(index: int, progress: Progress) -> None:
            curves.setdefault(index, Curve(started_s=time.process_time())).add(progress)

        with tempfile.TemporaryDirectory() as folder:
            reports = train_experiment(experiment, lessons, Path(folder), only=[cell], report=follow)
        return {
            "threads": threads,
            "phases": [
                {
                    "seed": report.seed,
                    "steps": curves[report.index].steps,
                    "seconds": report.seconds,
                    "curve": curves[report.index].points,
                    "rms": report.evaluation["rms"],
                }
                for report in reports
            ],
        }


def _read(setting: Setting) -> tuple[Experiment, list[Lesson]]:
    """Return the example and its lessons, of two steps each on a small scale."""
    registry = Registry.discover()
    experiment = load_experiment(setting.examples / EXAMPLE, registry=registry)
    if setting.quick:
        phases = [phase.model_copy(update={"steps": 2, "batch": 4}) for phase in experiment.train]
        experiment = experiment.model_copy(update={"train": tuple(phases)})
    return experiment, read_lessons(experiment, registry)
