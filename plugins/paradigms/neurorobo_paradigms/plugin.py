"""What the bundle brings to neurorobo."""

from neurorobo.plugins import hookimpl
from neurorobo.plugins.registry import Registrar


@hookimpl
def neurorobo_register(registry: Registrar) -> None:
    """Register the bodies and the tasks of the experiments."""
    registry.add(
        "body",
        "paradigms.conditioning_chamber",
        "neurorobo_paradigms.eyeblink.conditioning_chamber_config:ConditioningChamberConfig",
        "an eye, its lid, a tone and an air puff, for eyeblink conditioning",
    )
    registry.add(
        "task",
        "paradigms.eyeblink",
        "neurorobo_paradigms.eyeblink.eyeblink_task_config:EyeblinkTaskConfig",
        "shut the eye before the air puff comes",
    )
