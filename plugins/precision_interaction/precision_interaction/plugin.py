"""What the bundle brings to neurorobo."""

from neurorobo.plugins import hookimpl
from neurorobo.plugins.registry import Registrar


@hookimpl
def neurorobo_register(registry: Registrar) -> None:
    """Register regions, teachers, baselines, training data, the rig and its task."""
    for name, target, summary in (
        (
            "hippocampus",
            "regions.hippocampus_config:HippocampusConfig",
            "expects the contact of the coming periods; a doubly recurrent spiking network",
        ),
        (
            "cerebellum",
            "regions.cerebellum_config:CerebellumConfig",
            "compensates the radial force; mossy fibres to deep nuclei, spiking",
        ),
        (
            "prefrontal_cortex",
            "regions.prefrontal_cortex_config:PrefrontalCortexConfig",
            "plans the axial speed; a block-based spiking network",
        ),
        (
            "adaptive_hippocampus",
            "regions.adaptive_hippocampus_config:AdaptiveHippocampusConfig",
            "the hippocampus, which re-estimates the contact from what is felt",
        ),
        (
            "adaptive_cerebellum",
            "regions.adaptive_cerebellum_config:AdaptiveCerebellumConfig",
            "the cerebellum, which learns from the force that it leaves",
        ),
        (
            "comparator",
            "regions.comparator_config:ComparatorConfig",
            "feels the contact, and tells in what it differs from the one expected",
        ),
        ("law", "teachers.contact_expectation_config:ContactLawConfig", "teacher of the hippocampus: the contact law"),
        (
            "identified_law",
            "rig.identified_law_config:IdentifiedLawConfig",
            "teacher of the hippocampus: the law of an identified contact",
        ),
        (
            "predictive",
            "teachers.compensators_config:PredictiveConfig",
            "teacher of the cerebellum: zeroes the expected force",
        ),
        (
            "profile",
            "teachers.compensators_config:ProfileConfig",
            "teacher of the cerebellum: the paper's Gaussian path",
        ),
        ("planner", "teachers.planner_config:PlannerConfig", "teacher of the prefrontal cortex: the paper's planner"),
        ("approach", "regions.approach_config:ApproachConfig", "expects no contact before the known gap is closed"),
        ("pid", "baselines.pid_config:PidConfig", "baseline: a PID controller of the radial force"),
        (
            "trapezoid",
            "baselines.fixed_plans_config:TrapezoidConfig",
            "baseline: largest acceleration, cruise, largest deceleration",
        ),
        (
            "fixed_step",
            "baselines.fixed_plans_config:FixedStepConfig",
            "baseline: the same axial distance in every period",
        ),
    ):
        registry.add("region", f"precision.{name}", f"precision_interaction.{target}", summary)
    for name, target, summary in (
        ("insertion_speeds", "data.insertion_speeds:InsertionSpeedsConfig", "axial speeds, for the hippocampus"),
        (
            "compensation_states",
            "data.compensation_states:CompensationStatesConfig",
            "forces and expected contacts, for the cerebellum",
        ),
        (
            "planning_states",
            "data.planning_states:PlanningStatesConfig",
            "situations on the way to the end, for the prefrontal cortex",
        ),
    ):
        registry.add("data", f"precision.{name}", f"precision_interaction.{target}", summary)
    registry.add(
        "body",
        "precision.insertion_rig",
        "precision_interaction.rig.insertion_rig_config:InsertionRigConfig",
        "simulated rig: axial elevator, radial stage, force sensor",
    )
    registry.add(
        "physics",
        "precision.contact_path",
        "precision_interaction.rig.contact_path_config:ContactPathConfig",
        "the contact of a simulated insertion, felt by an emulated rig",
    )
    registry.add(
        "body",
        "precision.hardware_rig",
        "precision_interaction.rig.hardware_rig_config:HardwareRigConfig",
        "real stages and a force sensor of a rig file, supervised",
    )
    registry.add(
        "body",
        "precision.mujoco_rig",
        "precision_interaction.rig.mujoco_rig_config:MujocoRigConfig",
        "the same rig with a contact that MuJoCo solves (extra `mujoco`)",
    )
    registry.add(
        "task",
        "precision.insertion",
        "precision_interaction.rig.insertion_task_config:InsertionTaskConfig",
        "insert the peg to its full depth",
    )
    registry.add(
        "command",
        "precision.reproduce",
        "precision_interaction.reproduce.command:reproduce",
        "measure the paper's figures and tables again and write a report",
    )
    registry.add(
        "command",
        "precision.identify",
        "precision_interaction.identification.command:identify",
        "fit the contact of a rig to a log of insertions",
    )
