"""The core's own types, registered as any plugin registers its types."""

from neurorobo.plugins.hookspec import hookimpl
from neurorobo.plugins.registry import Registrar


@hookimpl
def neurorobo_register(registry: Registrar) -> None:
    """Register the types of the core under the prefix ``core``."""
    registry.add("region", "core.sum", "neurorobo.regions.sum_config:SumConfig", "adds two quantities of one unit")
    registry.add(
        "rule",
        "core.supervise",
        "neurorobo.learning.phase:SupervisePhase",
        "learns from a teacher by surrogate gradients",
    )
    registry.add(
        "recorder",
        "core.trajectory",
        "neurorobo.experiment.trajectory:TrajectoryRecorder",
        "every number of every tick, as Parquet",
    )
    registry.add(
        "recorder",
        "core.rerun",
        "neurorobo.views.recording:RerunRecorder",
        "scene, time series and spike rasters, for the rerun viewer",
    )
