"""What the tests of rigs share: a plugin registry, devices of every kind, and rig files made of them."""

import copy
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from precision_interaction import plugin as precision_interaction
from stage_hardware import plugin
from stage_hardware.rig.rig_config import RigConfig, load_rig

from neurorobo.config.document import dump
from neurorobo.plugins import Registry

EXAMPLES = Path(__file__).parents[2] / "examples" / "rigs"

AXIS = {
    "travel": "-2..3 mm",
    "resolution": "1 um",
    "speed": "10 mm/s",
    "acceleration": "500 mm/s^2",
    "start": "0.5 mm",
}
FINE = {**AXIS, "resolution": "0.01 um"}

STAGES: dict[str, dict[str, Any]] = {
    "shot": {
        "type": "stages.shot",
        "port": "/dev/ttyUSB0",
        "controller": "SHOT-302GS",
        "baud": 38400,
        "axes": {"x": {**AXIS, "number": 1}, "y": {**AXIS, "number": 2, "resolution": "0.5 um", "division": 4}},
    },
    "shot without acknowledgement": {
        "type": "stages.shot",
        "port": "/dev/ttyUSB0",
        "controller": "GSC-02",
        "axes": {"x": {**AXIS, "number": 2}},
    },
    "hit": {
        "type": "stages.hit",
        "port": "/dev/ttyUSB0",
        "controller": "HSC-103",
        "axes": {"x": {**FINE, "number": 3}, "y": {**FINE, "number": 1, "inverted": True}},
    },
    "ds102": {
        "type": "stages.ds102",
        "port": "/dev/ttyUSB0",
        "axes": {"x": {**AXIS, "number": 1, "origin_type": 3}},
    },
    "ds102 with divided steps, at its lower switch": {
        "type": "stages.ds102",
        "port": "/dev/ttyUSB0",
        "axes": {"x": {**AXIS, "travel": "0..3 mm", "number": 3, "origin_type": 5, "drive_division": 1}},
    },
    "ds102, at its upper switch": {
        "type": "stages.ds102",
        "port": "/dev/ttyUSB0",
        "axes": {"x": {**AXIS, "travel": "-3..0 mm", "start": "-1 mm", "number": 2, "origin_type": 6}},
    },
    "pi_gcs": {
        "type": "stages.pi_gcs",
        "port": "socket://192.168.0.1:50000",
        "identity": "C-884",
        "axes": {
            "x": {**FINE, "identifier": "1"},
            "y": {**AXIS, "identifier": "B", "reference": "lower_limit", "limits_inverted": True},
        },
    },
    "pi_gcs on a serial line, declared": {
        "type": "stages.pi_gcs",
        "port": "/dev/ttyUSB0",
        "axes": {"x": {**FINE, "reference": "declared", "declared": "1 mm"}},
    },
    "venus_1": {
        "type": "stages.venus_1",
        "port": "/dev/ttyUSB0",
        "axes": {"x": {**FINE, "number": 3, "origin": "-2.5 mm"}, "y": {**FINE, "number": 1, "origin": "-2 mm"}},
    },
    "venus_2": {
        "type": "stages.venus_2",
        "port": "socket://192.168.0.1:4000",
        "axes": {"x": {**FINE, "number": 2, "origin": "-2.5 mm", "inverted": True}},
    },
    "mock_stage": {"type": "stages.mock_stage", "axes": {"x": AXIS, "y": {**AXIS, "inverted": True}}},
}

SENSOR: dict[str, Any] = {
    "type": "stages.ati_net_ft",
    "largest_force": ["18 N", "18 N", "18 N"],
    "largest_torque": ["250 mN*m", "250 mN*m", "250 mN*m"],
    "force_resolution": "4 mN",
    "torque_resolution": "0.05 mN*m",
}

WALL = {"physics": {"type": "stages.wall", "axes": ["x"], "at": "1 mm", "stiffness": "-2 mN/um", "component": "Fy"}}


def registry() -> Registry:
    found = Registry()
    found.add_plugin("stages", plugin)
    found.add_plugin("precision", precision_interaction)  # the contact of the examples
    return found


def rig(*stages: str, **more: Any) -> dict[str, Any]:
    """Return the content of a rig file, each controller at a port of its own."""
    controllers = copy.deepcopy({f"controller_{number}": STAGES[name] for number, name in enumerate(stages)})
    for number, stage in enumerate(controllers.values()):
        if "port" in stage:
            stage["port"] = f"{stage['port'][:-1]}{number}"
    return {
        "neurorobo_rig": 1,
        "name": "bench",
        "controllers": controllers,
        **copy.deepcopy({"force_sensor": SENSOR, **more}),
    }


def written(folder: Path, content: Any) -> Path:
    path = folder / "rig.yaml"
    path.write_text(content if isinstance(content, str) else dump(content))
    return path


def loaded(folder: Path, content: Any) -> RigConfig:
    return load_rig(written(folder, content), registry())


def until(holds: Callable[[], bool], within_s: float = 10.0) -> None:
    deadline = time.monotonic() + within_s
    while not holds():
        assert time.monotonic() < deadline, "it did not come about in time"
        time.sleep(0.01)
