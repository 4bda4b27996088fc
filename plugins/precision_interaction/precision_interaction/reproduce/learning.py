"""How fast the three regions learn from scratch, as `neurorobo train examples/peg_in_hole.yaml` teaches them."""

import json
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import torch

from neurorobo.config.experiment import Experiment, load_experiment
from neurorobo.experiment.build import build_region
from neurorobo.experiment.lessons import Lesson, read_lessons
from neurorobo.experiment.train import train_experiment
from neurorobo.experiment.weights import weights_file
from neurorobo.learning.supervise import Progress
from neurorobo.plugins import Registry
from neurorobo.regions.weights import load_weights, to_grid
from precision_interaction.reproduce.row import Result, Row, Setting

EXAMPLE = "peg_in_hole.yaml"
REGIONS = ("hippocampus", "cerebellum", "prefrontal_cortex")
POINTS = 60
"""Points of a phase's curve; each is the mean over the steps since the one before."""


@dataclass
class Curve:
    """The errors of a phase: ``points`` hold processor seconds since ``started_s`` and rms errors since the last one.

    Errors are those of each step's batch, before the step.
    """

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
        """Return the example and the shipped weights: other regions act with them, and what is trained is compared."""
        experiment = load_experiment(setting.examples / EXAMPLE)
        weights = [weights_file(name, experiment) for name, config in experiment.regions.items() if config.weights]
        return [setting.examples / EXAMPLE, *weights]

    def measure(self, cell: str, setting: Setting) -> Result:
        """Train one region through all of its phases; only the times differ from run to run."""
        experiment, lessons = _read(setting)
        curves: dict[int, Curve] = {}
        threads = torch.get_num_threads()
        started_s = time.process_time()

        def follow(index: int, progress: Progress) -> None:
            curves.setdefault(index, Curve(started_s)).add(progress)

        with tempfile.TemporaryDirectory() as folder:
            reports = train_experiment(experiment, lessons, Path(folder), only=[cell], report=follow)
            same = same_as_shipped(cell, Path(folder) / f"{cell}.safetensors", experiment)
        return {
            "threads": threads,
            "same_as_shipped": same,
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


def same_as_shipped(region: str, trained: Path, experiment: Experiment) -> dict[str, int]:
    """Return how many entries of trained weights, rounded to the grids of the shipped ones, are the same as these."""
    config = experiment.regions[region]
    ours, shipped = (build_region(config, experiment, torch.Generator()) for _ in range(2))
    load_weights(ours, trained)
    bits = json.loads(load_weights(shipped, weights_file(region, experiment))["fractional_bits"])
    mine, theirs = ours.state_dict(), shipped.state_dict()
    narrow = {name: to_grid(tensor, bits[name]) if name in bits else tensor for name, tensor in mine.items()}
    return {
        "same": sum(int((narrow[name] == tensor).sum()) for name, tensor in theirs.items()),
        "of": sum(tensor.numel() for tensor in theirs.values()),
    }


def _read(setting: Setting) -> tuple[Experiment, list[Lesson]]:
    """Return the example and its lessons, of two steps each on a small scale."""
    registry = Registry.discover()
    experiment = load_experiment(setting.examples / EXAMPLE, registry=registry)
    if setting.quick:
        phases = [phase.model_copy(update={"steps": 2, "batch": 4}) for phase in experiment.train]
        experiment = experiment.model_copy(update={"train": tuple(phases)})
    return experiment, read_lessons(experiment, registry)
