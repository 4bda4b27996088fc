"""From an experiment file to the things that run: plan, brain, body and task."""

import hashlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import torch

from neurorobo.config.experiment import Experiment, raise_faults
from neurorobo.errors import ConfigError, Fault, NeuroroboError
from neurorobo.experiment.plan import build_plan
from neurorobo.graph.brain import Brain
from neurorobo.graph.plan import Plan
from neurorobo.plugins.imports import import_target
from neurorobo.regions import RegionConfig
from neurorobo.regions.region import Region
from neurorobo.regions.weights import load_weights, pretrained_path
from neurorobo.tasks.task import Task

implementation = import_target
"""Returns the class that a configuration names as its ``implementation``."""


def build_region(config: RegionConfig, experiment: Experiment, generator: torch.Generator) -> Region:
    """Build one region without loading weights; a ConfigError if what it is configured to be cannot be built."""
    try:
        region: Region = implementation(config.implementation)(config, experiment.clock, generator)
    except ValueError as error:  # layers and synapses refuse impossible sizes
        raise ConfigError([Fault((), f"cannot be built: {error}")]) from error
    return region


def build_brain(experiment: Experiment, plan: Plan | None = None) -> Brain:
    """Build every region that the steps use, with its weights; fresh ones come from the experiment's seed and the
    region's name.

    Raises :class:`ConfigError` with the place of every region that cannot be built and weights file that cannot be
    used.
    """
    plan = plan or build_plan(experiment)
    faults: list[Fault] = []
    regions: dict[str, Region] = {}
    for name in dict.fromkeys(use.region for use in plan.uses()):
        config = experiment.regions[name]
        try:
            region = build_region(config, experiment, _generator(experiment.seed, name))
        except ConfigError as error:
            faults += error.under("regions", name).faults
            continue
        try:
            if config.weights is not None:
                load_weights(region, weights_file(config, experiment))
        except NeuroroboError as error:
            faults.append(Fault(("regions", name, "weights"), str(error)))
        regions[name] = region.eval()
    raise_faults(experiment.document, faults)
    return Brain(plan, regions)


def build_task(experiment: Experiment) -> Task[Any] | None:
    """Build body and task, or nothing if the experiment has no body."""
    if experiment.body is None:
        return None
    if experiment.task is None:
        raise ConfigError(
            [Fault(("task",), "a body needs a task that says when an episode ends; add `task: {type: ...}`")]
        )
    body = implementation(experiment.body.implementation)(experiment.body)
    task: Task[Any] = implementation(experiment.task.implementation)(experiment.task, body)
    return task


def _generator(seed: int, name: str) -> torch.Generator:
    """Return a generator of a region's own, so that two of one type do not get the same weights."""
    digest = hashlib.sha256(f"{seed}/{name}".encode()).digest()
    return torch.Generator().manual_seed(int.from_bytes(digest[:8], "big"))


def weights_file(config: RegionConfig, experiment: Experiment) -> Path:
    """Return the file that ``weights`` means: a shipped one, or a path from the folder of the experiment's file."""
    if config.weights == "pretrained":
        return pretrained_path(config, experiment.clock)
    return (Path(experiment.document.source).parent / Path(config.weights or "").expanduser()).resolve()


def untrained(experiment: Experiment) -> Iterable[str]:
    """Yield the names of regions that spike and have no weights yet, for a warning."""
    for name, config in experiment.regions.items():
        ports = [*config.inputs(experiment.clock).values(), *config.outputs(experiment.clock).values()]
        if config.weights is None and any(port.code for port in ports):
            yield name
