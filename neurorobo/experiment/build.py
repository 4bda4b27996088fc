"""From an experiment file to the things that run: plan, brain, body and task."""

import importlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import torch

from neurorobo.config.experiment import Experiment, raise_faults
from neurorobo.errors import ConfigError, Fault, NeuroroboError
from neurorobo.experiment.plan import build_plan
from neurorobo.graph.brain import Brain
from neurorobo.graph.plan import Plan
from neurorobo.regions import RegionConfig
from neurorobo.regions.region import Region
from neurorobo.regions.weights import load_weights, pretrained_path
from neurorobo.tasks.task import Task


def build_region(config: RegionConfig, experiment: Experiment, generator: torch.Generator) -> Region:
    """Build one region without loading weights."""
    region: Region = implementation(config.implementation)(config, experiment.clock, generator)
    return region


def build_brain(experiment: Experiment, plan: Plan | None = None) -> Brain:
    """Build every region that the steps use, with its weights; fresh weights come from the experiment's seed.

    Raises :class:`ConfigError` with the place of every weights file that cannot be used.
    """
    plan = plan or build_plan(experiment)
    faults: list[Fault] = []
    regions: dict[str, Region] = {}
    for name in dict.fromkeys(use.region for use in plan.uses()):
        config = experiment.regions[name]
        generator = torch.Generator().manual_seed(experiment.seed)
        region = build_region(config, experiment, generator)
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


def weights_file(config: RegionConfig, experiment: Experiment) -> Path:
    """Return the file that ``weights`` means: a shipped one, or a path from the folder of the experiment's file."""
    if config.weights == "pretrained":
        return pretrained_path(config, experiment.clock)
    return (Path(experiment.document.source).parent / Path(config.weights or "").expanduser()).resolve()


def implementation(target: str) -> Any:
    """Import ``package.module:Class``; whatever goes wrong is the plugin's fault and says so."""
    module, _, attribute = target.partition(":")
    try:
        return getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError) as error:
        raise NeuroroboError(
            f"`{target}` cannot be imported ({error}); reinstall the plugin that provides it"
        ) from error


def untrained(experiment: Experiment) -> Iterable[str]:
    """Yield the names of regions that spike and have no weights yet, for a warning."""
    for name, config in experiment.regions.items():
        ports = [*config.inputs(experiment.clock).values(), *config.outputs(experiment.clock).values()]
        if config.weights is None and any(port.code for port in ports):
            yield name
