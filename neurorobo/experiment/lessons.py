"""The training phases of an experiment, checked: which region learns what from whom."""

from collections.abc import Iterator
from dataclasses import dataclass

from pydantic import BaseModel

from neurorobo.config.experiment import Experiment, raise_faults
from neurorobo.config.plugged import read_plugged
from neurorobo.errors import ConfigError, Fault, did_you_mean
from neurorobo.learning.phase import DataConfig, SupervisePhase
from neurorobo.plugins import Registry
from neurorobo.regions import RegionConfig


@dataclass(frozen=True)
class Lesson:
    """One phase and what it names: the pupil's configuration, its teacher's, and that of the data."""

    phase: SupervisePhase
    pupil: RegionConfig
    teacher: RegionConfig
    data: DataConfig


def read_lessons(experiment: Experiment, registry: Registry) -> list[Lesson]:
    """Check every training phase without building any network; raise all faults with their places in the file."""
    faults: list[Fault] = []
    lessons = []
    for index, phase in enumerate(experiment.train):
        found = _read(phase, experiment, registry)
        try:
            lessons += list(found)
        except ConfigError as error:
            faults += error.under("train", index).faults
    raise_faults(experiment.document, faults)
    return lessons


def _read(phase: BaseModel, experiment: Experiment, registry: Registry) -> Iterator[Lesson]:
    if not isinstance(phase, SupervisePhase):
        raise ConfigError([Fault(("phase",), f"a {type(phase).__name__} cannot be run by `neurorobo train`")])
    pupil = experiment.regions.get(phase.region)
    if pupil is None:
        raise ConfigError(
            [Fault(("region",), f"there is no region `{phase.region}`{did_you_mean(phase.region, experiment.regions)}")]
        )
    faults: list[Fault] = []
    parts: dict[str, BaseModel] = {}
    for key, kind in (("teacher", "region"), ("data", "data")):
        try:
            parts[key] = read_plugged(kind, getattr(phase, key), registry)  # type: ignore[arg-type]
        except ConfigError as error:
            faults += error.under(key).faults
    try:
        phase.check(pupil.inputs(experiment.clock), pupil.outputs(experiment.clock))
    except ConfigError as error:
        faults += error.faults
    if faults:
        raise ConfigError(faults)
    teacher, data = parts["teacher"], parts["data"]
    assert isinstance(teacher, RegionConfig)
    assert isinstance(data, DataConfig)
    yield Lesson(phase, pupil, teacher, data)
