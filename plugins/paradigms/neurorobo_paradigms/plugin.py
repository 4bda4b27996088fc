"""What the bundle brings to neurorobo."""

from neurorobo.plugins import hookimpl
from neurorobo.plugins.registry import Registrar

BODIES = (
    (
        "conditioning_chamber",
        "eyeblink.conditioning_chamber_config:ConditioningChamberConfig",
        "an eye, its lid, a tone and an air puff, for eyeblink conditioning",
    ),
    (
        "turntable",
        "vestibulo_ocular.turntable_config:TurntableConfig",
        "a head that is turned before a screen that turns, and an eye",
    ),
    ("arena", "path_memory.arena_config:ArenaConfig", "an agent that is led along paths, and then walks alone"),
)
TASKS = (
    ("eyeblink", "eyeblink.eyeblink_task_config:EyeblinkTaskConfig", "shut the eye before the air puff comes"),
    (
        "stable_gaze",
        "vestibulo_ocular.gaze_task_config:GazeTaskConfig",
        "keep the image still on the retina; gain and phase of the reflex",
    ),
    (
        "path_recall",
        "path_memory.path_recall_config:PathRecallConfig",
        "walk each path alone, from place to place",
    ),
)
REGIONS = (
    (
        "liquid",
        "path_memory.liquid_config:LiquidConfig",
        "a random recurrent spiking network that remembers what it heard",
    ),
    (
        "least_squares_readout",
        "path_memory.readout_config:LeastSquaresReadoutConfig",
        "a weighted sum of filtered spikes, learned at once by recursive least squares",
    ),
)


@hookimpl
def neurorobo_register(registry: Registrar) -> None:
    """Register the bodies, the tasks and the regions of the experiments."""
    for name, target, summary in BODIES:
        registry.add("body", f"paradigms.{name}", f"neurorobo_paradigms.{target}", summary)
    for name, target, summary in TASKS:
        registry.add("task", f"paradigms.{name}", f"neurorobo_paradigms.{target}", summary)
    for name, target, summary in REGIONS:
        registry.add("region", f"paradigms.{name}", f"neurorobo_paradigms.{target}", summary)
