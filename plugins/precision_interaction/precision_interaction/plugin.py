"""What the bundle brings to neurorobo."""

from neurorobo.plugins import hookimpl
from neurorobo.plugins.registry import Registrar


@hookimpl
def neurorobo_register(registry: Registrar) -> None:
    """Register regions, teachers, baselines, training data, the rig and its task."""
    for name, target, summary in (
        (
            "hippocampus",
            "hippocampus_config:HippocampusConfig",
            "expects the contact of the coming periods; a doubly recurrent spiking network",
        ),
        (
            "cerebellum",
            "cerebellum_config:CerebellumConfig",
            "compensates the radial force; mossy fibres to deep nuclei, spiking",
        ),
        (
            "prefrontal_cortex",
            "prefrontal_cortex_config:PrefrontalCortexConfig",
            "plans the axial speed; a block-based spiking network",
        ),
        ("law", "analytic_configs:ContactLawConfig", "teacher of the hippocampus: the contact law"),
        ("predictive", "analytic_configs:PredictiveConfig", "teacher of the cerebellum: zeroes the expected force"),
        ("profile", "analytic_configs:ProfileConfig", "teacher of the cerebellum: the paper's Gaussian path"),
        ("planner", "analytic_configs:PlannerConfig", "teacher of the prefrontal cortex: the paper's planner"),
        ("approach", "analytic_configs:ApproachConfig", "expects no contact before the known gap is closed"),
        ("pid", "analytic_configs:PidConfig", "baseline: a PID controller of the radial force"),
        (
            "trapezoid",
            "analytic_configs:TrapezoidConfig",
            "baseline: largest acceleration, cruise, largest deceleration",
        ),
        ("fixed_step", "analytic_configs:FixedStepConfig", "baseline: the same axial distance in every period"),
    ):
        registry.add("region", f"precision.{name}", f"precision_interaction.{target}", summary)
    for name, target, summary in (
        ("insertion_speeds", "speed_data:InsertionSpeedsConfig", "axial speeds, for the hippocampus"),
        (
            "compensation_states",
            "compensation_data:CompensationStatesConfig",
            "forces and expected contacts, for the cerebellum",
        ),
        (
            "planning_states",
            "planning_data:PlanningStatesConfig",
            "situations on the way to the end, for the prefrontal cortex",
        ),
    ):
        registry.add("data", f"precision.{name}", f"precision_interaction.{target}", summary)
    registry.add(
        "body",
        "precision.insertion_rig",
        "precision_interaction.rig_config:InsertionRigConfig",
        "simulated rig: axial elevator, radial stage, force sensor",
    )
    registry.add(
        "task",
        "precision.insertion",
        "precision_interaction.task_config:InsertionTaskConfig",
        "insert the peg to its full depth",
    )
