"""What the bundle brings to neurorobo."""

from neurorobo.plugins import hookimpl
from neurorobo.plugins.registry import Registrar


@hookimpl
def neurorobo_register(registry: Registrar) -> None:
    """Register the bodies, the tasks and the regions of the experiments."""
    _register_path_memory(registry)


def _register_path_memory(registry: Registrar) -> None:
    package = "neurorobo_paradigms.path_memory"
    for kind, name, target, summary in (
        ("body", "arena", "arena_config:ArenaConfig", "an agent that is led along paths, and then walks alone"),
        ("task", "path_recall", "path_recall_config:PathRecallConfig", "walk each path alone, place by place"),
        ("region", "liquid", "liquid_config:LiquidConfig", "a random recurrent spiking network that remembers"),
        (
            "region",
            "least_squares_readout",
            "readout_config:LeastSquaresReadoutConfig",
            "a weighted sum of filtered spikes, learned at once by recursive least squares",
        ),
    ):
        registry.add(kind, f"paradigms.{name}", f"{package}.{target}", summary)
