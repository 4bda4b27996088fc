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
from neurorobo.errors import Fault, NeuroroboError, did_you_mean
from neurorobo.experiment.build import build, build_region, noting, untrained
from neurorobo.experiment.lessons import Lesson
from neurorobo.experiment.plan import build_plan
from neurorobo.experiment.run_folder import write_json
from neurorobo.experiment.weights import weights_file
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

    Its place in the list, the regions, its seed, the time that all its sessions took together, and what its rule and
    the examination of that found.
    """

    index: int
    regions: tuple[str, ...]
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
    taught = list(dict.fromkeys(name for lesson in lessons for name in lesson.phase.pupils))
    if unknown := [name for name in only if name not in taught]:
        raise NeuroroboError(f"no phase under `train` is about `{unknown[0]}`{did_you_mean(unknown[0], taught)}")
    chosen = {
        i: lesson for i, lesson in enumerate(lessons) if not only or not lesson.phase.pupils.keys().isdisjoint(only)
    }
    courses = _build(experiment, chosen)
    rollouts = _rollouts(experiment, courses)
    for place in (folder, folder / CHECKPOINTS):
        make_folder(place)
    earlier = _earlier_reports(folder, lessons)
    files = _Files(folder, chosen, experiment)
    for index, course in courses.items():
        files.check(index, course.regions)
    reports = []
    for index, course in courses.items():
        phase = course.phase
        loop = {"loop": rollouts[index].fingerprint()} if index in rollouts else {}
        if files.finished(index):
            files.check_loop(index, course.regions, loop)
        else:
            checkpoints = Checkpoints(files.checkpoint(index), after=files.after(index))
            found = course.rule(
                **phase.keywords(course.regions),
                phase=phase,
                generator=torch.Generator().manual_seed(phase.seed),
                report=lambda progress, index=index: report(index, progress),
                checkpoints=checkpoints,
                **course.parts,
                **({"rollout": rollouts[index]} if index in rollouts else {}),
            )
            notes = {**files.notes(index), **loop, "seconds": f"{checkpoints.seconds:.1f}"}
            if found is not None:
                notes["found"] = json.dumps(found)
            for name, region in course.regions.items():
                save_weights(region, files.weights(index, name), notes)
        for name, region in course.regions.items():
            notes = load_weights(region, files.weights(index, name))
        files.checkpoint(index).unlink(missing_ok=True)
        evaluation: dict[str, Any] = json.loads(notes.get("found", "{}"))
        if course.examine is not None:
            examiner = torch.Generator().manual_seed(phase.seed + 1_000_003)
            evaluation |= course.examine(
                **phase.keywords(course.regions), phase=phase, generator=examiner, **course.parts
            )
        reports.append(PhaseReport(index, tuple(phase.pupils), phase.seed, float(notes["seconds"]), evaluation))
    for name, region in {name: region for each in courses.values() for name, region in each.regions.items()}.items():
        save_weights(region, folder / f"{name}.safetensors", {"experiment": experiment.config_hash})
    phases = earlier | {report.index: vars(report) for report in reports}
    write_json(folder / REPORT, {"phases": [phases[index] for index in sorted(phases)]})
    return reports


@dataclass(frozen=True)
class _Course:
    """A phase with all that was built for it; phases that train the same region share it."""

    phase: Phase
    regions: Mapping[str, Region]
    parts: Mapping[str, object]
    rule: Callable[..., Mapping[str, Any] | None]
    examine: Callable[..., Mapping[str, Any]] | None


def _build(experiment: Experiment, lessons: Mapping[int, Lesson]) -> dict[int, _Course]:
    """Build every region that learns, and what each phase trains it with; raise all faults with their places."""
    faults: list[Fault] = []
    regions: dict[str, Region] = {}
    courses = {}
    for index, lesson in lessons.items():
        phase = lesson.phase
        start = torch.Generator().manual_seed(phase.seed)
        for name, pupil in lesson.pupils.items():
            if name in regions:
                continue
            with noting(faults, "regions", name):
                regions[name] = build_region(pupil, experiment, start)
            if name in regions and phase.from_weights and pupil.weights is not None:
                with noting(faults, "regions", name, "weights"):
                    load_weights(regions[name], weights_file(name, experiment))
        own = {name: regions[name] for name in phase.pupils if name in regions}
        if len(own) == len(phase.pupils):
            with noting(faults, "train", index):
                phase.check_parameters({name: region.parameter_groups() for name, region in own.items()})
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
            courses[index] = _Course(phase, own, parts, rule, examine)
    raise_faults(experiment.document, faults)
    return courses


def _rollouts(experiment: Experiment, courses: Mapping[int, _Course]) -> dict[int, Any]:
    """Build the closed loop of each phase that needs one, around the very regions that learn.

    Those that learn in later phases act with the weights that the file names, as those do that do not learn.
    """
    rollouts = {}
    for index, course in courses.items():
        if course.phase.needs_rollout:
            plan = build_plan(experiment)
            taught = {
                name: region for i, each in courses.items() if i <= index for name, region in each.regions.items()
            }
            for name in untrained(experiment, plan):
                if name not in taught:
                    print(
                        f"note: train.{index}: `{name}` has no `weights` and learns later or not at all; "
                        "it acts with fresh ones",
                        file=sys.stderr,
                    )
            rollout = import_target(course.phase.rollout)
            rollouts[index] = rollout(experiment, plan, tuple(course.phase.pupils), taught)
    return rollouts


@dataclass(frozen=True)
class _Files:
    """The files of the phases in a training folder, and how each depends on the one before."""

    folder: Path
    lessons: Mapping[int, Lesson]
    experiment: Experiment

    def weights(self, index: int, region: str) -> Path:
        """Return the weights that a finished phase leaves of a region."""
        return self.folder / f"phase{index}_{region}.safetensors"

    def finished(self, index: int) -> bool:
        """Return whether the weights of all regions of a phase are there."""
        return all(self.weights(index, name).exists() for name in self.lessons[index].phase.pupils)

    def checkpoint(self, index: int) -> Path:
        """Return the checkpoint of a phase while it is unfinished."""
        return self.folder / CHECKPOINTS / f"phase{index}.safetensors"

    def after(self, index: int) -> str:
        """Return the SHA-256 of the weights files that a phase goes on from, nothing for a region that begins fresh."""
        begins = [self._start(index, name) for name in self.lessons[index].phase.pupils]
        return ",".join("" if file is None else hashlib.sha256(file.read_bytes()).hexdigest() for file in begins)

    def notes(self, index: int) -> dict[str, str]:
        """Return what the weights files of a phase say of how it was trained."""
        settings = json.dumps(self.lessons[index].phase.model_dump(mode="json"), sort_keys=True)
        return {"phase": str(index), "phase_config": settings, "after": self.after(index)}

    def check(self, index: int, regions: Mapping[str, Region]) -> None:
        """Raise a NeuroroboError if the files of a phase belong to other settings or other earlier weights."""
        files = [*(self.weights(index, name) for name in regions), self.checkpoint(index)]
        there = [file for file in files if file.exists()]
        for name in regions:
            before = self._before(index, name)
            if there and before is not None and not self.weights(before, name).exists():
                raise NeuroroboError(
                    f"{there[0]} goes on from {self.weights(before, name).name}, which is gone; remove it too, or "
                    "bring that file back, or choose another folder with `--out`"
                )
        for name, region in regions.items():
            if self.weights(index, name).exists():
                self._check_notes(index, name, load_weights(region, self.weights(index, name)))

    def check_loop(self, index: int, regions: Mapping[str, Region], loop: Mapping[str, str]) -> None:
        """Raise a NeuroroboError if a finished phase learned in another closed loop than ``loop`` tells."""
        for name, region in regions.items():
            found = load_weights(region, self.weights(index, name))
            if {key: found.get(key) for key in loop} != dict(loop):
                changed = "in another closed loop: body, task, steps or the other regions have changed"
                raise self._refused(index, name, changed)

    def _check_notes(self, index: int, name: str, found: Mapping[str, str]) -> None:
        wanted = self.notes(index)
        if not wanted.keys() <= found.keys():
            difference = "by another version, which does not say how"
        elif found["phase_config"] != wanted["phase_config"]:
            difference = f"by other settings than those of `train.{index}`"
        elif found["after"] != wanted["after"]:
            difference = "from other weights than the phase before it has left"
        else:
            return
        raise self._refused(index, name, difference)

    def _refused(self, index: int, name: str, difference: str) -> NeuroroboError:
        return NeuroroboError(
            f"{self.weights(index, name)} was trained {difference}; remove it and those of the later phases of "
            f"`{name}`, or choose another folder with `--out`"
        )

    def _before(self, index: int, name: str) -> int | None:
        """Return the last phase before this one that trains the same region."""
        return max((i for i, lesson in self.lessons.items() if i < index and name in lesson.phase.pupils), default=None)

    def _start(self, index: int, name: str) -> Path | None:
        """Return the weights that a region begins a phase with, or nothing if they are fresh."""
        before = self._before(index, name)
        if before is not None:
            return self.weights(before, name)
        lesson = self.lessons[index]
        if lesson.phase.from_weights and lesson.pupils[name].weights is not None:
            return weights_file(name, self.experiment)
        return None


def _earlier_reports(folder: Path, lessons: Sequence[Lesson]) -> dict[int, Mapping[str, Any]]:
    """Return what the folder's report says of phases that there still are, by index."""
    path = folder / REPORT
    if not path.exists():
        return {}
    try:
        phases = {int(phase["index"]): phase for phase in json.loads(path.read_text(encoding="utf-8"))["phases"]}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise NeuroroboError(f"{path} is not the report of a training ({error!r}); remove it") from error
    known = {index: list(lesson.phase.pupils) for index, lesson in enumerate(lessons)}
    return {index: phase for index, phase in phases.items() if known.get(index) == phase.get("regions")}
