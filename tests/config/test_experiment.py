# ruff: noqa: E501 (messages are whole lines)
import json
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from neurorobo.config import Experiment
from neurorobo.config.document import dump, parse_document
from neurorobo.config.faults import raise_faults
from neurorobo.config.plugged_reader import read_plugged
from neurorobo.errors import ConfigError, Fault
from neurorobo.graph.spec import RepeatSpec, StepSpec
from neurorobo.plugins import Registry

from .conftest import Cortex, Faults, Load, Reach, Rig

GOOD = """\
neurorobo: 1
name: reach
time: {control: 1 s, radial: 200 ms}
body:
  type: zoo.rig
  stage_resolution: 500 nm
task: zoo.reach
regions:
  cortex: {type: zoo.cortex, size: 3, membrane: {kind: adaptive}}
steps:
  - repeat: 2
    steps:
      - look: {use: cortex, state: fork, force: body.force then look.force}
  - plan:
      use: cortex
      every: radial
      speed: previous plan.speed
command: {speed: plan.speed}
train:
  - {phase: zoo.drill, epochs: 3}
record: [zoo.tape]
"""


def test_a_file_becomes_an_experiment(load: Load) -> None:
    experiment = load(GOOD)
    assert (experiment.name, experiment.seed) == ("reach", 0)
    assert experiment.clock.periods_ns == {"control": 10**9, "radial": 2 * 10**8}
    assert experiment.body == Rig(type="zoo.rig", stage_resolution="0.5 um")  # type: ignore[arg-type]
    assert experiment.task == Reach(type="zoo.reach")
    assert isinstance(experiment.regions["cortex"], Cortex)
    assert experiment.command == {"speed": "plan.speed"}
    assert experiment.record == ("zoo.tape",)
    assert experiment.steps == (
        RepeatSpec(
            2,
            (
                StepSpec(
                    "look",
                    "cortex",
                    state="fork",
                    inputs={"force": "body.force then look.force"},
                    path=("steps", 0, "steps", 0, "look"),
                ),
            ),
            path=("steps", 0),
        ),
        StepSpec("plan", "cortex", every="radial", inputs={"speed": "previous plan.speed"}, path=("steps", 1, "plan")),
    )


def test_an_experiment_is_frozen(load: Load) -> None:
    with pytest.raises(ValueError, match="frozen"):
        load(GOOD).seed = 3


@settings(max_examples=30, deadline=None)
@given(
    seed=st.integers(0, 2**40),
    size=st.integers(1, 12),
    gain=st.floats(1e-9, 1e9),
    lo=st.floats(-1e6, 0),
    offsets=st.lists(st.floats(-1e3, 1e3), max_size=3),
    resolution_nm=st.integers(1, 10**6),
    control_ms=st.integers(1, 10**6),
    count=st.integers(1, 9),
)
def test_what_is_resolved_loads_again_to_the_same(
    seed: int, size: int, gain: float, lo: float, offsets: list[float], resolution_nm: int, control_ms: int, count: int
) -> None:
    from .conftest import _Zoo

    registry = Registry()
    registry.add_plugin("zoo", _Zoo())
    cortex = {
        "type": "zoo.cortex",
        "size": size,
        "gain": f"{gain} mN/um",
        "speed": f"{lo}..1 um/s",
        "offsets": [f"{x} um" for x in offsets],
        "neuron": "zoo.neuron",
    }
    content = parse_document(GOOD, "x.yaml").value | {"seed": seed, "regions": {"cortex": cortex}}
    content["time"] = {"control": f"{control_ms} ms", "radial": f"{control_ms * 100} us"}
    content["body"]["stage_resolution"] = f"{resolution_nm} nm"
    content["steps"][0]["repeat"] = count
    first = Experiment.from_document(parse_document(dump(content), "x.yaml"), registry)
    text = dump(first.resolved())
    second = Experiment.from_document(parse_document(text, "y.yaml"), registry)
    assert second == first
    assert second.regions == first.regions
    assert second.config_hash == first.config_hash
    assert dump(second.resolved()) == text
    json.dumps(first.resolved(), allow_nan=False)


def test_the_resolved_experiment_states_every_default(load: Load) -> None:
    resolved = load(GOOD).resolved()
    assert list(resolved) == [
        "neurorobo", "name", "seed", "time", "body", "task", "regions", "steps", "command", "train", "record",
    ]  # fmt: skip
    assert resolved["time"] == {"control": "1 s", "radial": "200 ms", "spike_step": "1 ms", "window": 50}
    assert resolved["body"] == {"type": "zoo.rig", "stage_resolution": "0.5 um"}
    assert resolved["regions"]["cortex"]["gain"] == "80 mN/um"
    assert resolved["steps"][1] == {
        "plan": {"use": "cortex", "state": "commit", "every": "radial", "speed": "previous plan.speed"}
    }


def test_the_hash_is_that_of_what_is_said_not_of_how(load: Load) -> None:
    base = load(GOOD)
    same = GOOD.replace("500 nm", "0.5 um").replace("task: zoo.reach", "task: {goal: 1 um, type: zoo.reach}")
    assert load(same + "seed: 0\n").config_hash == base.config_hash
    assert load("# a comment\n" + same) == base
    assert load(GOOD, "seed=1").config_hash != base.config_hash
    assert load(GOOD, "seed=1") != base
    assert len(base.config_hash) == 64


def test_overrides_are_validated_like_the_file(load: Load, faults: Faults) -> None:
    experiment = load(GOOD, "regions.cortex.size=5", "steps.0.repeat=7", "regions.other={type: zoo.cortex, size: 1}")
    assert isinstance(experiment.regions["cortex"], Cortex)
    assert experiment.regions["cortex"].size == 5
    assert isinstance(experiment.steps[0], RepeatSpec)
    assert experiment.steps[0].count == 7
    assert set(experiment.regions) == {"cortex", "other"}
    assert faults(GOOD, "regions.cortex.size=big", "body.type=zoo.rigg", "seeds.key=3") == [
        "--set regions.cortex.size=big: regions.cortex.size: must be a whole number (got 'big')",
        "--set body.type=zoo.rigg: body.type: unknown body `zoo.rigg`; did you mean `zoo.rig`?",
        "--set seeds.key=3: seeds: unknown key `seeds`; did you mean `seed` or `steps`?",
    ]


def test_a_fault_of_the_file_names_the_overrides_that_may_have_caused_it(faults: Faults) -> None:
    assert faults(GOOD, "regions.cortex.size=13") == [
        "x.yaml:9:3 with --set regions.cortex.size=13: regions.cortex: 13 neurons bring bad luck; take 12"
    ]
    assert faults(GOOD, "task=", "seed=3") == [
        "--set task=: task: is missing; a body needs a task, which says when an episode ends"
    ]
    assert faults(GOOD.replace("size: 3, ", ""), "body.type=zoo.rigg", "seed=3") == [
        "x.yaml:9:3: regions.cortex.size: is missing",
        "--set body.type=zoo.rigg: body.type: unknown body `zoo.rigg`; did you mean `zoo.rig`?",
        "note: the file was read with --set seed=3, which may be the cause",
    ]


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        # unknown keys
        ("  stage_", "  stag_", "6:3: body.stag_resolution: unknown key `stag_resolution`; did you mean `stage_resolution`?"),
        ("command:", "comand:", "18:1: comand: unknown key `comand`; did you mean `command`?"),
        ("size: 3", "size: 3, colour: 1", "9:39: regions.cortex.colour: unknown key `colour`; there are: carry, gain, layers, membrane, neuron, offsets, size, speed, type, weights"),
        ("adaptive}", "adaptive, strenth: 1}", "9:66: regions.cortex.membrane.strenth: unknown key `strenth`; did you mean `strength`?"),
        # units
        ("500 nm", "5 ms", "6:3: body.stage_resolution: '5 ms' is a time, wanted a length such as '1 um'"),
        ("500 nm", "0.5", "6:3: body.stage_resolution: 0.5 needs a unit, e.g. '0.5 um'"),
        ("500 nm", "-1 um", "6:3: body.stage_resolution: must be greater than 0 um (got '-1 um')"),
        # values
        ("size: 3", "size: -3", "9:30: regions.cortex.size: must be greater than 0 (got -3)"),
        ("size: 3", "size: 1.5", "9:30: regions.cortex.size: must be a whole number (got 1.5)"),
        ("size: 3, ", "", "9:3: regions.cortex.size: is missing"),
        ("size: 3", "size: 13", "9:3: regions.cortex: 13 neurons bring bad luck; take 12"),
        ("size: 3", "size: 3, layers: x", "9:39: regions.cortex.layers: must be a whole number (got 'x'); or must be a list (got 'x')"),
        ("size: 3", "size: 3, layers: [1, x]", "9:51: regions.cortex.layers.1: must be a whole number (got 'x')"),
        ("size: 3", "size: 3, carry: allways", "9:39: regions.cortex.carry: must be 'never', 'repeat' or 'always' (got 'allways'); did you mean `always`?"),
        ("size: 3", "size: 3, neuron: {type: zoo.neuron, threshold: 1 s}", "9:66: regions.cortex.neuron.threshold: '1 s' is a time, wanted a voltage such as '1 mV'"),
        ("kind: adaptive", "kind: adaptiv", "9:50: regions.cortex.membrane.kind: must be 'spiking', 'adaptive' (got 'adaptiv'); did you mean `adaptive`?"),
        ("{kind: adaptive}", "{strength: 1}", "9:39: regions.cortex.membrane.kind: is missing"),
        ("{kind: adaptive}", "{kind: adaptive, strength: x}", "9:66: regions.cortex.membrane.strength: must be a number (got 'x')"),
        ("{kind: adaptive}", "{kind: spiking, decay: 1.7}", "9:65: regions.cortex.membrane.decay: must be less than 1 (got 1.7)"),
        # types
        ("zoo.cortex", "zoo.cortx", "9:12: regions.cortex.type: unknown region `zoo.cortx`; did you mean `zoo.cortex` or"),
        ("zoo.cortex", "zoo.rig", "9:12: regions.cortex.type: `zoo.rig` is a body, not a region"),
        ("type: zoo.cortex, ", "", "9:3: regions.cortex.type: is missing; it names the kind of region, of which there are: "),
        ("zoo.cortex", "zoo.ghost", "9:12: regions.cortex.type: `zoo.ghost` belongs to the plugin zoo: `no_such_module:Ghost` cannot be imported (ModuleNotFoundError: No module named 'no_such_module'); repair or reinstall the plugin that provides it"),
        ("zoo.cortex", "zoo.stone", "9:12: regions.cortex.type: `zoo.stone` is broken: "),
        ("task: zoo.reach", "task: 3", "7:1: task: must be a mapping with a `type`"),
        ("zoo.drill", "zoo.dril", "20:6: train.0.phase: unknown rule `zoo.dril`; did you mean `zoo.drill`?"),
        ("epochs: 3", "epochs: many", "20:24: train.0.epochs: must be a whole number (got 'many')"),
        ("[zoo.tape]", "[zoo.tap]", "21:10: record.0: unknown recorder `zoo.tap`; did you mean `zoo.tape`?"),
        # the top level
        ("neurorobo: 1", "neurorobo: 2", "1:1: neurorobo: must be 1 (got 2)"),
        ("name: reach", "name: a/b", "2:1: name: names the run folder: it must be of letters, digits, '_', '.' and '-' (got 'a/b')"),
        ("name: reach", "name: reach\nseed: -1", "3:1: seed: must be greater than or equal to 0 (got -1)"),
        ("name: reach", "name: reach\nseed: true", "3:1: seed: must be a whole number (got true)"),
        ("name: reach\n", "", "1:1: name: is missing"),
        ("regions:\n  cortex:", "regions:\n  left cortex:", "9:3: regions.left cortex: must start with a letter and go on with letters, digits and _ (got 'left cortex')"),
        ("200 ms", "300 ms", "3:22: time.radial: 300 ms does not divide control: 1 s; choose e.g. 250 ms or 200 ms"),
        ("{control: 1 s, radial: 200 ms}", "1 s", "3:1: time: must be a mapping such as {control: 1 s, spike_step: 1 ms, window: 50}"),
        ("task: zoo.reach\n", "", "1:1: task: is missing; a body needs a task, which says when an episode ends"),
        ("task: zoo.reach", "task: zoo.reach\nepisode: {duration: 5 s}", "8:1: episode: is for experiments without a task; this one's task says when an episode ends"),
        # steps
        ("state: fork", "state: frok", "13:29: steps.0.steps.0.look.state: must be 'commit', 'fork' or 'fresh' (got 'frok'); did you mean `fork`?"),
        ("      use: cortex\n", "", "14:5: steps.1.plan.use: is missing"),
        ("previous plan.speed", "3", "17:7: steps.1.plan.speed: must be a reference such as 'plan.speed' (got 3)"),
        ("repeat: 2", "repeat: 0", "11:5: steps.0.repeat: must be greater than or equal to 1 (got 0)"),
        ("repeat: 2", "repeat: 2\n    twice: yes", "12:5: steps.0.twice: unknown key `twice`; there are: repeat, steps"),
        ("- plan:", "- act: {use: cortex}\n    plan:", "14:5: steps.1: must be one step, 'name: {use: region, ...}', or 'repeat' and 'steps' (got the keys 'act', 'plan')"),
        ("- look:", "- repeat: 2\n        steps: [{a: {use: cortex}}]\n      - look:", "11:5: steps.0: a repeat cannot hold another repeat; multiply the two counts"),
        ("- plan:", "- 2nd plan:", "14:5: steps.1.2nd plan: the name of a step must start with a letter and go on with letters, digits and _"),
        ("speed: plan.speed}", "speed: 3}", "18:11: command.speed: must be a reference such as 'plan.speed' (got 3)"),
    ],
)  # fmt: skip
def test_a_fault_is_one_line_with_place_path_and_cure(faults: Faults, old: str, new: str, line: str) -> None:
    assert GOOD.count(old) >= 1
    text = GOOD.replace(old, new, 1)
    [found] = faults(text)
    assert found.startswith(f"x.yaml:{line}")


def test_all_faults_are_reported_at_once_in_the_order_of_the_file(faults: Faults) -> None:
    text = (
        GOOD.replace("500 nm", "5 ms").replace("size: 3", "size: big").replace("zoo.drill", "zoo.dril")
        .replace("200 ms", "7 ms").replace("use: cortex\n", "state: on\n")
    )  # fmt: skip
    places = [line.split(": ")[:2] for line in faults(text, "seed=x", "name=''")]
    assert places == [
        ["x.yaml:3:22", "time.radial"],
        ["x.yaml:6:3", "body.stage_resolution"],
        ["x.yaml:9:30", "regions.cortex.size"],
        ["x.yaml:14:5", "steps.1.plan.use"],
        ["x.yaml:15:7", "steps.1.plan.state"],
        ["x.yaml:20:6", "train.0.phase"],
        ["--set seed=x", "seed"],
        ["--set name=''", "name"],
    ]


def test_an_experiment_without_body_or_task_says_how_long_it_lasts(load: Load, faults: Faults) -> None:
    text = "neurorobo: 1\nname: a\ntime: {control: 1 s}\nregions: {}\nsteps: [{a: {use: b}}]\n"
    experiment = load(text + "episode: {duration: 5 s}\n")
    assert experiment.episode is not None
    assert experiment.episode.duration == 5 * 10**9
    assert experiment.resolved()["episode"] == {"duration": "5 s"}
    assert faults(text) == [
        "x.yaml:1:1: episode: is missing; without a task, say when a run ends: 'episode: {duration: 5 s}'"
    ]
    assert faults(text + "episode: {duration: 0 s}") == [
        "x.yaml:6:11: episode.duration: must be longer than zero (got '0 s')"
    ]


def test_a_broken_plugin_is_reported_where_its_type_stands(
    load: Load, faults: Faults, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "broken_nr.py").write_text("import no_such_module")
    info = tmp_path / "broken_nr-0.2.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: broken-nr\nVersion: 0.2\n")
    (info / "entry_points.txt").write_text("[neurorobo.plugins]\nbroken = broken_nr\n")
    document = parse_document(GOOD.replace("zoo.reach", "broken.reach"), "x.yaml")
    monkeypatch.setenv("NEUROROBO_PLUGINS", "broken")
    with pytest.raises(ConfigError) as caught:
        Experiment.from_document(document, Registry.discover())
    assert (
        "x.yaml:7:1: task.type: `broken.reach` belongs to the plugin broken-nr 0.2, which failed to import: "
        "ModuleNotFoundError: No module named 'no_such_module'"
    ) in str(caught.value).splitlines()


def test_faults_found_later_get_their_places_too(load: Load) -> None:
    experiment = load(GOOD)
    raise_faults(experiment.document, [])
    path = ("steps", 0, "steps", 0, "look")
    with pytest.raises(ConfigError) as caught:
        raise_faults(
            experiment.document, [Fault((*path, "wrench"), "is not wired"), Fault((*path, "force"), "is no unit")]
        )
    assert str(caught.value).splitlines() == [
        "x.yaml:13:9: steps.0.steps.0.look.wrench: is not wired",
        "x.yaml:13:42: steps.0.steps.0.look.force: is no unit",
    ]


def test_a_plugged_value_can_be_read_on_its_own(registry: Registry) -> None:
    assert read_plugged("region", {"type": "zoo.cortex", "size": 1}, registry) == Cortex(type="zoo.cortex", size=1)
    with pytest.raises(ConfigError) as caught:
        read_plugged("region", {"type": "zoo.cortex", "size": 0, "gian": "1 mN/um"}, registry)
    assert [fault.path for fault in caught.value.faults] == [("size",), ("gian",)]
