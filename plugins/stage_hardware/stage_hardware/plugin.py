"""What the bundle brings to neurorobo."""

from neurorobo.plugins import hookimpl
from neurorobo.plugins.registry import Registrar

DEVICES = (
    ("shot", "shot:ShotConfig", "stage: SIGMA KOKI in SHOT mode, such as the SHOT-302GS"),
    ("hit", "hit:HitConfig", "stage: SIGMA KOKI in HIT mode, such as the HSC-103"),
    ("ds102", "ds102:DS102Config", "stage: Suruga Seiki DS102 and DS112"),
    ("pi_gcs", "pi_gcs:PiGcsConfig", "stage: Physik Instrumente, General Command Set 2.0"),
    ("venus_1", "venus:Venus1Config", "stage: Micos Corvus, Venus-1"),
    ("venus_2", "venus:Venus2Config", "stage: Micos Pollux and SMC, Venus-2"),
    ("micromanager", "micromanager:MicroManagerConfig", "stage: whatever Micro-Manager knows (extra `mm`)"),
    ("mock_stage", "mock_stage:MockStageConfig", "stage: one without a wire, in this process"),
    ("ati_net_ft", "net_ft:AtiNetFtConfig", "force sensor: ATI Net F/T"),
    ("pynetft", "net_ft:PynetftConfig", "force sensor: ATI Net F/T, through pynetft (extra `ati`)"),
    (
        "mock_force_sensor",
        "mock_force_sensor:MockForceSensorConfig",
        "force sensor: one without a wire, in this process",
    ),
)


@hookimpl
def neurorobo_register(registry: Registrar) -> None:
    """Register devices of rig files, what emulated rigs feel, and the commands of rigs."""
    for name, target, summary in DEVICES:
        registry.add("device", f"stages.{name}", f"stage_hardware.rig.devices.{target}", summary)
    registry.add(
        "physics", "stages.wall", "stage_hardware.rig.wall:WallConfig", "an elastic wall that an axis runs into"
    )
    registry.add(
        "command",
        "stages.emulate",
        "stage_hardware.rig.emulate_command:emulate",
        "bring up the devices of a rig file as emulators, with contact between them",
    )
    registry.add(
        "command",
        "stages.rig",
        "stage_hardware.rig.commissioning.command:rig",
        "commission a rig: check, home, identify, calibrate; reset one that is latched",
    )
