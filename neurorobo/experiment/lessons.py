"""The training phases of an experiment, checked: which region learns what from whom."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from pydantic import BaseModel

from neurorobo.config.experiment import Experiment
from neurorobo.config.faults import raise_faults
from neurorobo.config.plugged_reader import read_plugged
from neurorobo.errors import ConfigError, Fault, did_you_mean
from neurorobo.experiment.plan import build_plan
from neurorobo.learning.phase import DataConfig, Phase, Pupil, Surroundings
from neurorobo.plugins import Registry
from neurorobo.regions import RegionConfig
from neurorobo.regions.config import checked_ports


@runtime_checkable
class TellsParts(Protocol):
    """The configuration of a body that knows what its brain is to learn, such as what was measured on it."""

    def tell(self, part: BaseModel) -> BaseModel:
        """Return a teacher or source of data as it is for this body: the same, or one that follows from both."""


@dataclass(frozen=True)
class Lesson:
    """One phase, the configurations of the pupils that it names, and of each of its parts, such as ``teacher``."""

    phase: Phase
    pupils: Mapping[str, RegionConfig]
    parts: Mapping[str, BaseModel]

    @property
    def teacher(self) -> RegionConfig:
        """The teacher of a supervised phase."""
        teacher = self.parts["teacher"]
        assert isinstance(teacher, RegionConfig)
        return teacher

    @property
    def data(self) -> DataConfig:
        """The data of a supervised phase."""
        data = self.parts["data"]
        assert isinstance(data, DataConfig)
        return data


def read_lessons(experiment: Experiment, registry: Registry) -> list[Lesson]:
    """Check every training phase without building any network; raise all faults with their places in the file."""
    faults: list[Fault] = []
    lessons = []
    for index, phase in enumerate(experiment.train):
        try:
            lessons.append(_read(phase, experiment, registry))
        except ConfigError as error:
            faults += error.under("train", index).faults
    raise_faults(experiment.document, faults)
    return lessons


def _read(phase: BaseModel, experiment: Experiment, registry: Registry) -> Lesson:
    """Check one phase; the paths of its faults start at the phase."""
    if not isinstance(phase, Phase):
        message = f"a {type(phase).__name__} cannot be run by `neurorobo train`; its author has to derive it from Phase"
        raise ConfigError([Fault(("phase",), message)])
    faults = [
        Fault(path, f"there is no region `{name}`{did_you_mean(name, experiment.regions)}")
        for name, path in phase.pupils.items()
        if name not in experiment.regions
    ]
    if faults:
        raise ConfigError(faults)
    parts: dict[str, BaseModel] = {}
    for key, kind in phase.parts.items():
        try:
            part = read_plugged(kind, getattr(phase, key), registry)
            if isinstance(experiment.body, TellsParts) and (told := experiment.body.tell(part)) is not part:
                part = told
                phase = phase.model_copy(update={key: part.model_dump(mode="json")})
            parts[key] = part
            if isinstance(part, RegionConfig):
                checked_ports(part, experiment.clock)
        except ConfigError as error:
            faults += error.under(key).faults
    if faults:
        raise ConfigError(faults)
    plan = build_plan(experiment) if phase.needs_rollout else None
    pupils = {}
    for name, path in phase.pupils.items():
        if plan is not None and name not in {use.region for use in plan.uses()}:
            message = (
                "takes part in no step, so that it meets nothing by itself; use it in `steps`, or train it otherwise"
            )
            faults.append(Fault(path, f"`{name}` {message}"))
            continue
        config = experiment.regions[name]
        try:
            pupils[name] = Pupil(config, *checked_ports(config, experiment.clock))
        except ConfigError as error:
            faults += error.under(*path).faults
    if faults:
        raise ConfigError(faults)
    phase.check(Surroundings(pupils, parts, experiment.clock, plan, experiment.body))
    return Lesson(phase, {name: pupil.config for name, pupil in pupils.items()}, parts)
