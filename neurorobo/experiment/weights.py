"""The weights files that an experiment names: found, and checked without building a network."""

from collections.abc import Collection
from pathlib import Path

from neurorobo.config.experiment import Experiment
from neurorobo.config.faults import raise_faults
from neurorobo.errors import Fault, NeuroroboError
from neurorobo.graph.plan import Plan
from neurorobo.regions.weights_file import check_weights_file, pretrained_path


def weights_file(name: str, experiment: Experiment) -> Path:
    """Return the file that the ``weights`` of a region mean: a shipped one, or a path from where it was written."""
    config = experiment.regions[name]
    if config.weights == "pretrained":
        return pretrained_path(config, experiment.clock)
    folder = experiment.document.folder(("regions", name, "weights"))
    try:
        return (folder / Path(config.weights or "").expanduser()).resolve()
    except (OSError, RuntimeError, ValueError) as error:  # no such user, links in a circle, a zero byte
        raise NeuroroboError(f"'{config.weights}' is no path: {error}; name a file") from error


def check_weights(experiment: Experiment, plan: Plan, but: Collection[str] = ()) -> None:
    """Check the weights of the regions that the steps use, ``but`` some; a ConfigError has the place of every fault."""
    faults = []
    for name in dict.fromkeys(use.region for use in plan.uses()):
        config = experiment.regions[name]
        if config.weights is not None and name not in but:
            try:
                check_weights_file(weights_file(name, experiment), config, experiment.clock)
            except NeuroroboError as error:
                faults.append(Fault(("regions", name, "weights"), str(error)))
    raise_faults(experiment.document, faults, alone=True)
