"""Training an experiment: its phases in order, resumable, into a folder of weights."""

import hashlib
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from neurorobo.config.experiment import Experiment
from neurorobo.config.faults import raise_faults
from neurorobo.errors import Fault, NeuroroboError
from neurorobo.experiment.build import build, build_region, noting, untrained
from neurorobo.experiment.lessons import Lesson
from neurorobo.experiment.plan import build_plan
from neurorobo.experiment.rollout import Rollout
from neurorobo.experiment.run_folder import write_json
from neurorobo.files import make_folder
from neurorobo.learning.checkpoint import Checkpoints
from neurorobo.learning.phase import DataConfig, Phase
from neurorobo.learning.supervise import Progress
from neurorobo.plugins.imports import import_target
from neurorobo.regions import RegionConfig
from neurorobo.regions.region import Region
from neurorobo.regions.weights import load_weights, save_weights

REPORT = "training.json"
CHECKPOINTS = "checkpoints"


@dataclass(frozen=True)
class PhaseReport:
    """How a phase went.

    Its place in the list, the region, its seed, the time that all its sessions took together, and what the examination
    of its rule found.
    """

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
    nothing. Before any training it raises a ConfigError if a phase cannot be run, and a NeuroroboError if the folder
    cannot be written, or holds a phase that was trained by other settings or from other weights.
    """
    unknown = set(only) - {lesson.phase.region for lesson in lessons}
    if unknown:
        raise NeuroroboError(f"no training phase is about {', '.join(sorted(unknown))}; see `train` in the file")
    chosen = {i: lesson for i, lesson in enumerate(lessons) if not only or lesson.phase.region in only}
    courses = _build(experiment, chosen)
    rollouts = _rollouts(experiment, courses)
    for place in (folder, folder / CHECKPOINTS):
        make_folder(place)
    earlier = _earlier_reports(folder, lessons)
    files = _Files(folder, chosen)
    for index in chosen:
        files.check(index, courses[index].region)
    reports = []
    for index, course in courses.items():
        phase, region = course.phase, course.region
        loop = {"loop": rollouts[index].fingerprint()} if index in rollouts else {}
        if files.weights(index).exists():
            files.check_loop(index, region, loop)
        else:
            checkpoints = Checkpoints(files.checkpoint(index), after=files.after(index))
            course.rule(
                region=region,
                phase=phase,
                generator=torch.Generator().manual_seed(phase.seed),
                report=lambda progress, index=index: report(index, progress),
                checkpoints=checkpoints,
                **course.parts,
                **({"rollout": rollouts[index]} if index in rollouts else {}),
            )
            notes = {**files.notes(index), **loop, "seconds": f"{checkpoints.seconds:.1f}"}
            save_weights(region, files.weights(index), notes)
        notes = load_weights(region, files.weights(index))
        files.checkpoint(index).unlink(missing_ok=True)
        found: Mapping[str, Any] = {}
        if course.examine is not None:
            examiner = torch.Generator().manual_seed(phase.seed + 1_000_003)
            found = course.examine(region=region, phase=phase, generator=examiner, **course.parts)
        reports.append(PhaseReport(index, phase.region, phase.seed, float(notes["seconds"]), found))
    for name, region in {course.phase.region: course.region for course in courses.values()}.items():
        save_weights(region, folder / f"{name}.safetensors", {"experiment": experiment.config_hash})
    phases = earlier | {report.index: vars(report) for report in reports}
    write_json(folder / REPORT, {"phases": [phases[index] for index in sorted(phases)]})
    return reports


@dataclass(frozen=True)
class _Course:
    """A phase with all that was built for it; the phases of one region share the region."""

    phase: Phase
    region: Region
    parts: Mapping[str, object]
    rule: Callable[..., None]
    examine: Callable[..., Mapping[str, Any]] | None


def _build(experiment: Experiment, lessons: Mapping[int, Lesson]) -> dict[int, _Course]:
    """Build every region that learns, and what each phase trains it with; raise all faults with their places."""
    faults: list[Fault] = []
    regions: dict[str, Region] = {}
    courses = {}
    for index, lesson in lessons.items():
        phase = lesson.phase
        if phase.region not in regions:
            with noting(faults, "regions", phase.region):
                start = torch.Generator().manual_seed(phase.seed)
                regions[phase.region] = build_region(lesson.pupil, experiment, start)
        if phase.region in regions:
            with noting(faults, "train", index):
                phase.check_groups(regions[phase.region].parameter_groups())
        parts: dict[str, object] = {}
        for key, config in lesson.parts.items():
            with noting(faults, "train", index, key):
                if isinstance(config, RegionConfig):
                    parts[key] = build_region(config, experiment, torch.Generator())
                else:
                    assert isinstance(config, DataConfig)
                    parts[key] = build(config, experiment.clock)
        with noting(faults, "train", index):
            rule = import_target(phase.implementation)
            examine = None if phase.examination is None else import_target(phase.examination)
            if phase.region in regions:
                courses[index] = _Course(phase, regions[phase.region], parts, rule, examine)
    raise_faults(experiment.document, faults)
    return courses


def _rollouts(experiment: Experiment, courses: Mapping[int, _Course]) -> dict[int, Rollout]:
    """Build the closed loop of each phase that needs one, around the very regions that learn.

    Those that learn in later phases act with the weights that the file names, as those do that do not learn.
    """
    rollouts = {}
    for index, course in courses.items():
        if course.phase.needs_rollout:
            plan = build_plan(experiment)
            taught = {each.phase.region: each.region for i, each in courses.items() if i <= index}
            for name in untrained(experiment, plan):
                if name not in taught:
                    print(
                        f"note: train.{index}: `{name}` has no `weights` and learns later or not at all; "
                        "it acts with fresh ones",
                        file=sys.stderr,
                    )
            rollouts[index] = Rollout(experiment, plan, course.phase.region, taught)
    return rollouts


@dataclass(frozen=True)
class _Files:
    """The files of the phases in a training folder, and how each depends on the one before."""

    folder: Path
    lessons: Mapping[int, Lesson]

    def weights(self, index: int) -> Path:
        """Return the weights that a finished phase leaves."""
        return self.folder / f"phase{index}_{self.lessons[index].phase.region}.safetensors"

    def checkpoint(self, index: int) -> Path:
        """Return the checkpoint of a phase while it is unfinished."""
        return self.folder / CHECKPOINTS / f"phase{index}.safetensors"

    def after(self, index: int) -> str:
        """Return the SHA-256 of the weights file that a phase goes on from, or nothing for a region's first phase."""
        before = self._before(index)
        return "" if before is None else hashlib.sha256(self.weights(before).read_bytes()).hexdigest()

    def notes(self, index: int) -> dict[str, str]:
        """Return what the weights file of a phase says of how it was trained."""
        settings = json.dumps(self.lessons[index].phase.model_dump(mode="json"), sort_keys=True)
        return {"phase": str(index), "phase_config": settings, "after": self.after(index)}

    def check(self, index: int, region: Region) -> None:
        """Raise a NeuroroboError if the files of a phase belong to other settings or other earlier weights."""
        mine, before = self.weights(index), self._before(index)
        there = [file for file in (mine, self.checkpoint(index)) if file.exists()]
        if there and before is not None and not self.weights(before).exists():
            raise NeuroroboError(
                f"{there[0]} goes on from {self.weights(before).name}, which is gone; remove it too, or bring that "
                "file back, or choose another folder with `--out`"
            )
        if not mine.exists():
            return
        found, wanted = load_weights(region, mine), self.notes(index)
        if not wanted.keys() <= found.keys():
            difference = "by another version, which does not say how"
        elif found["phase_config"] != wanted["phase_config"]:
            difference = f"by other settings than those of `train.{index}`"
        elif found["after"] != wanted["after"]:
            difference = "from other weights than the phase before it has left"
        else:
            return
        raise self._refused(index, difference)

    def check_loop(self, index: int, region: Region, loop: Mapping[str, str]) -> None:
        """Raise a NeuroroboError if a finished phase learned in another closed loop than ``loop`` tells."""
        found = load_weights(region, self.weights(index))
        if {key: found.get(key) for key in loop} != dict(loop):
            raise self._refused(index, "in another closed loop: body, task, steps or the other regions have changed")

    def _refused(self, index: int, difference: str) -> NeuroroboError:
        return NeuroroboError(
            f"{self.weights(index)} was trained {difference}; remove it and those of the later phases of "
            f"`{self.lessons[index].phase.region}`, or choose another folder with `--out`"
        )

    def _before(self, index: int) -> int | None:
        """Return the last phase before this one that trains the same region."""
        region = self.lessons[index].phase.region
        return max(
            (i for i, lesson in self.lessons.items() if i < index and lesson.phase.region == region), default=None
        )


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
