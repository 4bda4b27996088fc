"""From an experiment file to the things that run: brain, body and task."""

import hashlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from types import MappingProxyType
from typing import Any

import torch

from neurorobo.bodies import BodyConfig
from neurorobo.config.experiment import Experiment
from neurorobo.config.faults import raise_faults
from neurorobo.errors import ConfigError, Fault, NeuroroboError
from neurorobo.experiment.plan import build_plan
from neurorobo.experiment.weights import weights_file
from neurorobo.graph.brain import Brain
from neurorobo.graph.plan import Plan
from neurorobo.learning.phase import DataConfig
from neurorobo.plugins.imports import import_target
from neurorobo.regions import RegionConfig
from neurorobo.regions.region import Region
from neurorobo.regions.weights import load_weights
from neurorobo.tasks import TaskConfig
from neurorobo.tasks.task import Task


def build(config: RegionConfig | BodyConfig | TaskConfig | DataConfig, *arguments: object) -> Any:
    """Build what a configuration describes, of it and ``arguments``.

    Raises a NeuroroboError if its implementation cannot be imported, refuses its settings (a ValueError, such as
    layers and synapses raise for impossible sizes), or lacks a file.
    """
    implementation = import_target(config.implementation)
    try:
        return implementation(config, *arguments)
    except (ValueError, OSError) as error:
        raise NeuroroboError(f"cannot be built: {error}") from error


def build_region(config: RegionConfig, experiment: Experiment, generator: torch.Generator) -> Region:
    """Build one region without loading weights; raises NeuroroboError as `build` does."""
    region: Region = build(config, experiment.clock, generator)
    return region


def build_brain(
    experiment: Experiment, plan: Plan | None = None, built: Mapping[str, Region] = MappingProxyType({})
) -> Brain:
    """Build every region that the steps use, with its weights; those in ``built`` are taken as they are.

    Fresh weights come from the experiment's seed and the region's name. Raises :class:`ConfigError` with the place of
    every region that cannot be built and weights file that cannot be used.
    """
    plan = plan or build_plan(experiment)
    faults: list[Fault] = []
    regions: dict[str, Region] = {}
    for name in _used(plan):
        if name in built:
            regions[name] = built[name]
            continue
        config = experiment.regions[name]
        with noting(faults, "regions", name):
            regions[name] = build_region(config, experiment, _generator(experiment.seed, name)).eval()
        if name in regions and config.weights is not None:
            with noting(faults, "regions", name, "weights"):
                load_weights(regions[name], weights_file(name, experiment))
    raise_faults(experiment.document, faults)
    return Brain(plan, regions)


def build_task(experiment: Experiment) -> Task[Any] | None:
    """Build body and task, or nothing if the experiment has no body; a ConfigError with the place of what cannot be."""
    if experiment.body is None or experiment.task is None:  # a file has both or neither
        return None
    faults: list[Fault] = []
    body = task = None
    with noting(faults, "body"):
        body = build(experiment.body)
    if body is not None:
        with noting(faults, "task"):
            task = build(experiment.task, body)
    raise_faults(experiment.document, faults)
    return task


@contextmanager
def noting(faults: list[Fault], *path: str | int) -> Iterator[None]:
    """Turn what the user can cure into faults at a place of the file."""
    try:
        yield
    except ConfigError as error:
        faults += error.under(*path).faults
    except NeuroroboError as error:
        faults.append(Fault(path, str(error)))


def untrained(experiment: Experiment, plan: Plan) -> Iterator[str]:
    """Yield the names of regions in use that spike and have no weights yet, for a warning."""
    for name in _used(plan):
        config = experiment.regions[name]
        ports = [*config.inputs(experiment.clock).values(), *config.outputs(experiment.clock).values()]
        if config.weights is None and any(port.code for port in ports):
            yield name


def _used(plan: Plan) -> list[str]:
    """Return the names of the regions that the steps use, in the order of their first use."""
    return list(dict.fromkeys(use.region for use in plan.uses()))


def _generator(seed: int, name: str) -> torch.Generator:
    """Return a generator of a region's own, so that two of one type do not get the same weights."""
    digest = hashlib.sha256(f"{seed}/{name}".encode()).digest()
    return torch.Generator().manual_seed(int.from_bytes(digest[:8], "big"))
