"""The training phases of an experiment, checked: which region learns what from whom."""

from collections.abc import Mapping
from dataclasses import dataclass

from pydantic import BaseModel

from neurorobo.config.experiment import Experiment
from neurorobo.config.faults import raise_faults
from neurorobo.config.plugged_reader import read_plugged
from neurorobo.errors import ConfigError, Fault, did_you_mean
from neurorobo.experiment.plan import build_plan
from neurorobo.learning.phase import DataConfig, Phase
from neurorobo.plugins import Registry
from neurorobo.regions import RegionConfig
from neurorobo.regions.config import checked_ports


@dataclass(frozen=True)
class Lesson:
    """One phase, the configuration of the pupil that it names, and of each of its parts, such as ``teacher``."""

    phase: Phase
    pupil: RegionConfig
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
    pupil = experiment.regions.get(phase.region)
    if pupil is None:
        raise ConfigError(
            [Fault(("region",), f"there is no region `{phase.region}`{did_you_mean(phase.region, experiment.regions)}")]
        )
    faults: list[Fault] = []
    parts: dict[str, BaseModel] = {}
    for key, kind in phase.parts.items():
        try:
            parts[key] = part = read_plugged(kind, getattr(phase, key), registry)
            if isinstance(part, RegionConfig):
                checked_ports(part, experiment.clock)
        except ConfigError as error:
            faults += error.under(key).faults
    if faults:
        raise ConfigError(faults)
    if phase.needs_rollout and phase.region not in {use.region for use in build_plan(experiment).uses()}:
        message = "takes part in no step, so that it meets nothing by itself; use it in `steps`, or train it otherwise"
        raise ConfigError([Fault(("region",), f"`{phase.region}` {message}")])
    try:
        inputs, outputs = checked_ports(pupil, experiment.clock)
    except ConfigError as error:
        raise error.under("region") from error
    phase.check(pupil, inputs, outputs, experiment.clock, parts)
    return Lesson(phase, pupil, parts)
