"""The plan of an experiment, checked and compiled without building any network."""

from neurorobo.config.experiment import Experiment
from neurorobo.config.faults import raise_faults
from neurorobo.errors import ConfigError
from neurorobo.graph.compile import compile_graph
from neurorobo.graph.plan import Plan


def build_plan(experiment: Experiment) -> Plan:
    """Compile the region graph; its faults are raised with their places in the file."""
    body = experiment.body
    try:
        return compile_graph(
            experiment.steps,
            experiment.command,
            experiment.regions,
            experiment.clock,
            {} if body is None else body.sensors(),
            {} if body is None else body.actuators(),
        )
    except ConfigError as error:
        raise_faults(experiment.document, error.faults)
        raise
