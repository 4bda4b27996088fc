"""Training an experiment: its phases in order, resumable, into a folder of weights."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from neurorobo.config.experiment import Experiment
from neurorobo.errors import NeuroroboError
from neurorobo.experiment.build import build_region, implementation
from neurorobo.experiment.lessons import Lesson
from neurorobo.experiment.run_folder import write_json
from neurorobo.learning.supervise import Checkpoints, Evaluation, Progress, evaluate, supervise
from neurorobo.regions.region import Region
from neurorobo.regions.weights import load_weights, save_weights


@dataclass(frozen=True)
class PhaseReport:
    """How a phase went: its place in the list, the region, its seed and time, and the errors that are left."""

    index: int
    region: str
    seed: int
    seconds: float
    evaluation: Mapping[str, Any]


def train_experiment(
    experiment: Experiment,
    lessons: Sequence[Lesson],
    folder: Path,
    *,
    only: Sequence[str] = (),
    report: Callable[[int, Progress], None] = lambda index, progress: None,
) -> list[PhaseReport]:
    """Run the training phases of ``experiment`` in order, those of the regions ``only`` if given.

    ``folder`` gets ``<region>.safetensors`` for each trained region, ``training.json`` with the evaluations, and
    checkpoints of the unfinished phase. Called again with the same folder it goes on where it stopped; Ctrl-C loses
    nothing.
    """
    unknown = set(only) - {lesson.phase.region for lesson in lessons}
    if unknown:
        raise NeuroroboError(f"no training phase is about {', '.join(sorted(unknown))}; see `train` in the file")
    reports = []
    regions: dict[str, Region] = {}
    for index, lesson in enumerate(lessons):
        phase = lesson.phase
        if only and phase.region not in only:
            continue
        region = regions.get(phase.region)
        if region is None:
            start = torch.Generator().manual_seed(phase.seed)
            region = regions[phase.region] = build_region(lesson.pupil, experiment, start)
        done = folder / f"phase{index}_{phase.region}.safetensors"
        teacher = build_region(lesson.teacher, experiment, torch.Generator())
        data = implementation(lesson.data.implementation)(lesson.data, experiment.clock)
        if not done.exists():
            started = time.monotonic()
            supervise(
                region,
                teacher,
                data,
                phase,
                torch.Generator().manual_seed(phase.seed),
                report=lambda progress, index=index: report(index, progress),  # type: ignore[misc]
                checkpoints=Checkpoints(folder / "checkpoints" / f"phase{index}.safetensors"),
            )
            save_weights(region, done, {"phase": str(index), "seconds": f"{time.monotonic() - started:.1f}"})
        seconds = float(load_weights(region, done)["seconds"])
        examiner = torch.Generator().manual_seed(phase.seed + 1_000_003)
        found = evaluate(region, teacher, data, examiner, outputs=phase.loss, unroll=phase.unroll)
        reports.append(PhaseReport(index, phase.region, phase.seed, seconds, plain(found)))
    for name, region in regions.items():
        save_weights(region, folder / f"{name}.safetensors", {"experiment": experiment.config_hash})
    write_json(folder / "training.json", {"phases": [vars(report) for report in reports]})
    return reports


def plain(evaluation: Evaluation) -> dict[str, Any]:
    """Return an evaluation as what JSON can hold."""
    tables = {"rms": evaluation.rms, "largest": evaluation.largest, "bias": evaluation.bias}
    figures = {name: {port: error.tolist() for port, error in table.items()} for name, table in tables.items()}
    return {**figures, "firing_rates": dict(evaluation.rates)}
