"""What the bundle brings to neurorobo."""

from neurorobo.plugins import hookimpl
from neurorobo.plugins.registry import Registrar


@hookimpl
def neurorobo_register(registry: Registrar) -> None:
    """Register the bodies and the tasks of the experiments."""
    registry.add(
        "body",
        "paradigms.turntable",
        "neurorobo_paradigms.vestibulo_ocular.turntable_config:TurntableConfig",
        "a head that is turned before a screen that turns, and an eye",
    )
    registry.add(
        "task",
        "paradigms.stable_gaze",
        "neurorobo_paradigms.vestibulo_ocular.gaze_task_config:GazeTaskConfig",
        "keep the image still on the retina; gain and phase of the reflex",
    )
