"""What the bundle brings to neurorobo."""

from neurorobo.plugins import hookimpl
from neurorobo.plugins.registry import Registrar


@hookimpl
def neurorobo_register(registry: Registrar) -> None:
    """Register the bodies, the tasks and the regions of the experiments."""
    _register_path_memory(registry)


def _register_path_memory(registry: Registrar) -> None:
    package = "neurorobo_paradigms.path_memory"
    registry.add(
        "body",
        "paradigms.arena",
        f"{package}.arena_config:ArenaConfig",
        "an agent that is led along paths, and then walks alone",
    )
    registry.add(
        "task",
        "paradigms.path_recall",
        f"{package}.path_recall_config:PathRecallConfig",
        "walk each path alone, from place to place",
    )
    registry.add(
        "region",
        "paradigms.liquid",
        f"{package}.liquid_config:LiquidConfig",
        "a random recurrent spiking network that remembers what it heard",
    )
    registry.add(
        "region",
        "paradigms.least_squares_readout",
        f"{package}.readout_config:LeastSquaresReadoutConfig",
        "a weighted sum of filtered spikes, learned at once by recursive least squares",
    )
