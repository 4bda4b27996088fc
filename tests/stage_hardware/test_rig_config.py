"""Rig files: what they say, what is wrong with them and where, and that they can be written again."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import pytest
from stage_hardware.emulators.mock_stage import MockStage
from stage_hardware.rig.device_config import AxisConfig, StageConfig
from stage_hardware.rig.rig_config import load_rig

from neurorobo.errors import ConfigError, NeuroroboError
from neurorobo.plugins import Registrar, hookimpl
from tests.stage_hardware.rigs import EXAMPLES, SENSOR, STAGES, WALL, loaded, registry, rig, written

Content = dict[str, Any]

MICROMANAGER = {
    "type": "stages.micromanager",
    "configuration": "/scope.cfg",
    "properties": {"XY": {"Velocity": "2.0"}},
    "axes": {"x": {**STAGES["mock_stage"]["axes"]["x"], "device": "XY", "coordinate": "x"}},
}


class AcmeConfig(StageConfig):
    """A stage of another plugin."""

    type: Literal["acme.stage"]
    axes: dict[str, AxisConfig]

    @property
    def address(self) -> str:
        return "nowhere"

    def build(self, name: str) -> MockStage:
        return MockStage(f"acme {name}", {key: axis.axis for key, axis in self.axes.items()})


class Acme:
    """Another plugin."""

    @hookimpl
    def neurorobo_register(self, registry: Registrar) -> None:
        registry.add("device", "acme.stage", f"{__name__}:AcmeConfig")


@pytest.mark.parametrize("stage", STAGES)
def test_every_stage_is_built_as_it_is_described(tmp_path: Path, stage: str) -> None:
    built = loaded(tmp_path, rig(stage)).build()
    assert list(built.stages) == ["controller_0"]
    for name, axis in STAGES[stage]["axes"].items():
        lo, hi = (float(end) for end in axis["travel"].removesuffix(" mm").split(".."))
        start = float(axis["start"].removesuffix(" mm"))
        ends = (lo - start, hi - start) if not axis.get("inverted") else (start - hi, start - lo)
        assert built.limits(name) == pytest.approx([1000 * end for end in ends])
        assert (built.axes[name].speed, built.axes[name].acceleration) == (10_000, 500_000)


@pytest.mark.parametrize("sensor", ["ati_net_ft", "pynetft", "mock_force_sensor"])
def test_every_force_sensor_is_built_as_it_is_described(tmp_path: Path, sensor: str) -> None:
    described = rig("mock_stage", force_sensor={**SENSOR, "type": f"stages.{sensor}", "rate": "500 Hz"})
    built = loaded(tmp_path, described).build().sensor
    assert (built.name, built.rate_Hz) == ("force_sensor", 500)
    assert {name: (one.unit, one.largest, one.resolution) for name, one in built.components.items()} == {
        **dict.fromkeys(("Fx", "Fy", "Fz"), ("mN", 18_000, 4)),
        **dict.fromkeys(("Tx", "Ty", "Tz"), ("mN*m", 250, 0.05)),
    }


def test_micro_manager_is_built_and_has_no_emulator(tmp_path: Path) -> None:
    config = loaded(tmp_path, rig(controllers={"scope": MICROMANAGER}))
    assert config.build().limits("x") == (-2500, 2500)
    with pytest.raises(NeuroroboError, match=r"scope: stages.micromanager has no emulator; "):
        config.controllers["scope"].emulate("scope")


@pytest.mark.parametrize("stage", [*STAGES, "micromanager"])
def test_what_is_written_loads_to_the_same(tmp_path: Path, stage: str) -> None:
    controllers = {"it": MICROMANAGER if stage == "micromanager" else STAGES[stage]}
    config = loaded(tmp_path, rig(controllers=controllers, emulate=WALL))
    again = loaded(tmp_path, config.dump())
    assert again == config
    assert again.dump() == config.dump()


def test_the_examples_load_and_move_as_they_say() -> None:
    for name, axial_um, radial_um, within_s in (("shot_ds102", 150, 25, 0.5), ("pi_venus", 8, 1, 0.02)):
        config = load_rig(EXAMPLES / f"{name}.yaml", registry())
        built = config.build()
        assert config.name == name
        assert built.limits("x") == built.limits("y") == (-2000, 2000)
        for axis, way_um in (("x", radial_um), ("y", radial_um), ("z", axial_um)):
            speed, acceleration = built.axes[axis].speed, built.axes[axis].acceleration
            ramps_um = speed**2 / acceleration
            fast, slow = way_um / speed + speed / acceleration, 2 * math.sqrt(way_um / acceleration)
            assert (fast if way_um > ramps_um else slow) < within_s


def _without(*path: str) -> Callable[[Content], None]:
    def change(content: Content) -> None:
        *above, last = path
        for key in above:
            content = content[key]
        del content[last]

    return change


def _with(value: object, *path: str) -> Callable[[Content], None]:
    def change(content: Content) -> None:
        *above, last = path
        for key in above:
            content = content[key]
        content[last] = value

    return change


X = ("controllers", "controller_0", "axes", "x")


@pytest.mark.parametrize(
    ("stage", "change", "fault"),
    [
        ("shot", _without(*X, "travel"), "axes.x.travel: is missing"),
        (
            "shot",
            _with({**STAGES["ds102"], "port": "/dev/ttyUSB0"}, "controllers", "elevator"),
            "elevator.port: is that of `controller_0` too (got '/dev/ttyUSB0'); each controller has its own",
        ),
        ("shot", _without(*X, "speed"), "axes.x.speed: is missing"),
        ("shot", _with("3..-2 mm", *X, "travel"), "does not rise"),
        ("shot", _with("3.1 mm", *X, "start"), "axes.x.start: is beyond the travel of -2000..3000 um (got 3100 um)"),
        ("shot", _with(5, *X, "start"), "axes.x.start: 5 needs a unit"),
        ("shot", _with("0 mm/s", *X, "speed"), "axes.x.speed: must be greater than 0 um/s"),
        ("shot", _with(True, *X, "invert"), "unknown key `invert`; did you mean `inverted`?"),
        ("shot", _with("SHOT-303", "controllers", "controller_0", "controller"), "`SHOT-302GS`"),
        ("shot", _with(2, *X, "number"), "controllers.controller_0: axes have connectors of their own"),
        ("shot", _with("2 m/s", *X, "speed"), "axis x has a speed of 2000000"),
        ("hit", _with("1 um", *X, "resolution"), "axes.x.resolution: an HSC-103 counts steps of 0.01 um (got 1 um)"),
        ("venus_1", _with("0 mm", *X, "origin"), "axes.x.origin: is within the travel"),
        ("venus_1", _with(4, *X, "number"), "axes.x.number: a Corvus has connectors 1 to 3 (got 4)"),
        ("ds102", _with(13, *X, "origin_type"), "axes.x.origin_type: must be less than or equal to 12 (got 13)"),
        ("pi_gcs", _with("1", *X[:3], "y", "identifier"), "axes.y.identifier: is that of axis `x` too (got 1)"),
        ("shot", _with({}, "controllers", "controller_0", "axes"), "axes: "),
        ("shot", _with("my rig", "name"), "name: names files"),
        ("shot", _with(2, "neurorobo_rig"), "neurorobo_rig: must be 1"),
        ("shot", _with("stages.shoot", "controllers", "controller_0", "type"), "unknown device `stages.shoot`"),
        ("shot", _with(SENSOR, "controllers", "wrist"), "`stages.ati_net_ft` is no stage; put it under `force_sensor`"),
        (
            "shot",
            _with(STAGES["ds102"], "force_sensor"),
            "force_sensor.type: `stages.ds102` is no force sensor; put it under `controllers`",
        ),
        (
            "shot",
            _with({"physics": {**WALL["physics"], "axes": ["xx"]}}, "emulate"),
            "emulate.physics.axes.0: the rig has no axis `xx`; did you mean `x`?",
        ),
    ],
)
def test_each_fault_is_told_at_its_place(
    tmp_path: Path, stage: str, change: Callable[[Content], None], fault: str
) -> None:
    content = rig(stage)
    change(content)
    with pytest.raises(ConfigError) as refused:
        loaded(tmp_path, content)
    assert fault in str(refused.value)
    assert all(line.startswith(f"{tmp_path / 'rig.yaml'}:") for line in str(refused.value).splitlines())


def test_all_faults_are_told_at_once_with_lines_and_columns(tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as refused:
        loaded(
            tmp_path,
            "neurorobo_rig: 1\n"
            "name: bench\n"
            "controllers:\n"
            "  first: {type: stages.mock_stage, axes: {x: {travel: 1..2 mm, resolution: 1 um, speed: 1 um/s,\n"
            "    acceleration: 1 um/s^2}}}\n"
            "  second:\n"
            "    type: stages.mock_stage\n"
            "    axes:\n"
            "      x: {travel: 1..2 mm, resolution: 1 um, speed: 1 um/s, acceleration: 1 um/s^2, start: 1 mm}\n"
            "force_sensor: stages.nothing\n",
        )
    first, second, third = str(refused.value).splitlines()
    assert ":4:43: controllers.first.axes.x.start: is missing" in first
    assert ":9:7: controllers.second.axes.x: there is an axis `x` of `first` already" in second
    assert ":10:1: force_sensor.type: unknown device `stages.nothing`" in third


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("", "rig.yaml:1:1: is empty; "),
        ("- 1\n", "is a list, not a mapping; "),
        ("neurorobo: 1\nname: x\n", "this is an experiment, not a rig; a rig file starts with 'neurorobo_rig: 1'"),
        ("neurorobo_rig: [1\n", "is not valid YAML"),
    ],
)
def test_what_is_no_rig_file_is_told_so(tmp_path: Path, text: str, fault: str) -> None:
    with pytest.raises(NeuroroboError) as refused:
        loaded(tmp_path, text)
    assert fault in str(refused.value)


def test_a_file_that_is_not_there_may_be_that_of_an_emulated_rig(tmp_path: Path) -> None:
    with pytest.raises(NeuroroboError, match=r"rig\.yaml: there is no such file; .*while `neurorobo emulate` runs"):
        load_rig(tmp_path / "rig.yaml", registry())


def test_other_plugins_bring_devices_the_same_way(tmp_path: Path) -> None:
    plugins = registry()
    plugins.add_plugin("acme", Acme())
    content = rig(controllers={"it": {"type": "acme.stage", "axes": STAGES["mock_stage"]["axes"]}})
    config = load_rig(written(tmp_path, content), plugins)
    assert config.build().stages["it"].name == "acme it"
