"""Training an experiment: its phases in order, resumable, into a folder of weights."""

import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from neurorobo.config.experiment import Experiment, raise_faults
from neurorobo.errors import ConfigError, Fault, NeuroroboError
from neurorobo.experiment.build import build_region, implementation
from neurorobo.experiment.lessons import Lesson
from neurorobo.experiment.run_folder import write_json
from neurorobo.learning.phase import Phase
from neurorobo.learning.supervise import Checkpoints, Progress, plain
from neurorobo.regions import RegionConfig
from neurorobo.regions.region import Region
from neurorobo.regions.weights import load_weights, save_weights

__all__ = ["PhaseReport", "plain", "train_experiment"]

REPORT = "training.json"


@dataclass(frozen=True)
class PhaseReport:
    """How a phase went: its place in the list, the region, its seed, the time that all its sessions took together, and
    what the examination of its rule found."""

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
    nothing. Raises a ConfigError before any training if a phase cannot be run, and a NeuroroboError if the folder
    holds a phase that was trained by other settings.
    """
    unknown = set(only) - {lesson.phase.region for lesson in lessons}
    if unknown:
        raise NeuroroboError(f"no training phase is about {', '.join(sorted(unknown))}; see `train` in the file")
    chosen = {i: lesson for i, lesson in enumerate(lessons) if not only or lesson.phase.region in only}
    regions, parts = _build(experiment, chosen)
    earlier = _earlier_reports(folder, lessons)
    reports = []
    for index, lesson in chosen.items():
        phase: Phase = lesson.phase
        region = regions[phase.region]
        done = folder / f"phase{index}_{phase.region}.safetensors"
        checkpoints = Checkpoints(folder / "checkpoints" / f"phase{index}.safetensors")
        spent = checkpoints.file.with_suffix(".seconds")
        settings = json.dumps(phase.model_dump(mode="json"), sort_keys=True)
        if not done.exists():
            with _timed(spent):
                implementation(phase.implementation)(
                    region=region,
                    phase=phase,
                    generator=torch.Generator().manual_seed(phase.seed),
                    report=lambda progress, index=index: report(index, progress),
                    checkpoints=checkpoints,
                    **parts[index],
                )
            save_weights(region, done, {"phase": str(index), "seconds": spent.read_text(), "phase_config": settings})
        notes = load_weights(region, done)
        # A file of an earlier version does not say how it was trained.
        if notes.get("phase_config", settings) != settings:
            raise NeuroroboError(
                f"{done} was trained by other settings than those of `train.{index}`; remove it and those of the later "
                f"phases of `{phase.region}`, or choose another folder with `--out`"
            )
        for file in (checkpoints.file, spent):
            file.unlink(missing_ok=True)
        found: Mapping[str, Any] = {}
        if phase.examination is not None:
            examiner = torch.Generator().manual_seed(phase.seed + 1_000_003)
            found = implementation(phase.examination)(region=region, phase=phase, generator=examiner, **parts[index])
        reports.append(PhaseReport(index, phase.region, phase.seed, float(notes["seconds"]), found))
    for name, region in regions.items():
        save_weights(region, folder / f"{name}.safetensors", {"experiment": experiment.config_hash})
    phases = earlier | {report.index: vars(report) for report in reports}
    write_json(folder / REPORT, {"phases": [phases[index] for index in sorted(phases)]})
    return reports


def _build(
    experiment: Experiment, lessons: Mapping[int, Lesson]
) -> tuple[dict[str, Region], dict[int, dict[str, object]]]:
    """Build every region that learns, and what each phase trains it with; raise all faults with their places."""
    faults: list[Fault] = []
    regions: dict[str, Region] = {}
    parts: dict[int, dict[str, object]] = {}
    for index, lesson in lessons.items():
        phase: Phase = lesson.phase
        with _noting(faults, "regions", phase.region):
            if phase.region not in regions:
                start = torch.Generator().manual_seed(phase.seed)
                regions[phase.region] = build_region(lesson.pupil, experiment, start)
        if phase.region in regions:
            with _noting(faults, "train", index):
                phase.check_groups(regions[phase.region].parameter_groups())
        parts[index] = {}
        for key, config in lesson.parts.items():
            with _noting(faults, "train", index, key):
                if isinstance(config, RegionConfig):
                    parts[index][key] = build_region(config, experiment, torch.Generator())
                else:
                    parts[index][key] = implementation(config.implementation)(config, experiment.clock)  # type: ignore[attr-defined] # every part has one
    raise_faults(experiment.document, faults)
    return regions, parts


@contextmanager
def _noting(faults: list[Fault], *path: str | int) -> Iterator[None]:
    """Turn what the user can cure into faults at a place of the file."""
    try:
        yield
    except ConfigError as error:
        faults += error.under(*path).faults
    except NeuroroboError as error:
        faults.append(Fault(path, str(error)))


@contextmanager
def _timed(file: Path) -> Iterator[None]:
    """Add the time that the block takes to that of earlier sessions in a file, also if it is interrupted."""
    before = float(file.read_text()) if file.exists() else 0.0
    started = time.monotonic()
    try:
        yield
    finally:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(f"{before + time.monotonic() - started:.1f}")


def _earlier_reports(folder: Path, lessons: Sequence[Lesson]) -> dict[int, Mapping[str, Any]]:
    """Return what the folder's report says of phases that there still are, by index."""
    path = folder / REPORT
    if not path.exists():
        return {}
    try:
        phases = {int(phase["index"]): phase for phase in json.loads(path.read_text(encoding="utf-8"))["phases"]}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise NeuroroboError(f"{path} is not the report of a training ({error!r}); remove it") from error
    known = {index: lesson.phase.region for index, lesson in enumerate(lessons)}
    return {index: phase for index, phase in phases.items() if known.get(index) == phase.get("region")}
