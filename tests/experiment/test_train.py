"""Training an experiment: what is refused before it starts, what is resumed, and rules of plugins."""

import json
import re
import signal
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
import pytest
import torch
from safetensors import safe_open
from torch import Tensor, nn

from neurorobo.clock import Clock
from neurorobo.config.experiment import Experiment, load_experiment
from neurorobo.errors import ConfigError, NeuroroboError
from neurorobo.experiment import train as train_module
from neurorobo.experiment.build import build_brain, build_region, build_task
from neurorobo.experiment.closed_loop import run_episodes
from neurorobo.experiment.lessons import read_lessons
from neurorobo.experiment.train import train_experiment
from neurorobo.learning.checkpoint import Checkpoints
from neurorobo.learning.on_policy import Rollout
from neurorobo.learning.phase import DataConfig, Phase, RegionPhase
from neurorobo.learning.supervise import Progress
from neurorobo.plugins import Registrar, Registry, hookimpl
from neurorobo.regions import Port, RegionConfig
from neurorobo.regions.region import Probe, Region, State
from neurorobo.regions.weights import save_weights
from tests.experiment import toys

HERE = "tests.experiment.test_train"


class ScaleConfig(RegionConfig):
    """y = gain * x, from a gain of its own; as a teacher it can be made unfit."""

    implementation: ClassVar[str] = f"{HERE}:Scale"
    type: Literal["school.scale"] = "school.scale"
    gain: float = 0.0
    unit: str = "um"
    reads: str = "x"
    says: str = "y"

    def inputs(self, clock: Clock) -> dict[str, Port]:
        return {self.reads: Port("mN", 2)}

    def outputs(self, clock: Clock) -> dict[str, Port]:
        return {self.says: Port(self.unit, 2)}


class Scale(Region):
    def __init__(self, config: ScaleConfig, clock: Clock, generator: torch.Generator) -> None:
        super().__init__(config, clock, generator)
        if config.gain > 100:
            raise ValueError("a gain above 100 is too much")
        self.gain = nn.ParameterDict({"value": nn.Parameter(torch.tensor([config.gain]))})

    def step(
        self, inputs: Mapping[str, Tensor], state: State, probe: Probe | None = None
    ) -> tuple[dict[str, Tensor], State]:
        return {"y": self.gain["value"] * inputs["x"]}, state


class NoiseConfig(DataConfig):
    implementation: ClassVar[str] = f"{HERE}:Noise"
    type: Literal["school.noise"] = "school.noise"
    broken: bool = False


class Noise:
    def __init__(self, config: NoiseConfig, clock: Clock) -> None:
        if config.broken:
            raise NeuroroboError("there is nothing to draw from")

    def draw(self, batch: int, generator: torch.Generator) -> Mapping[str, Tensor]:
        return {"x": torch.randn(batch, 2, generator=generator)}


class SetPhase(RegionPhase):
    """A rule of a plugin's own: it sets the gain."""

    implementation: ClassVar[str] = f"{HERE}:set_gain"
    phase: Literal["school.set"] = "school.set"
    to: float


def set_gain(*, region: Region, phase: SetPhase, report: Any, **_: object) -> None:
    with torch.no_grad():
        region.get_parameter("gain.value").fill_(phase.to)
    report(Progress(1, 1, 0.0, {}, 0.0))


class GonePhase(RegionPhase):
    implementation: ClassVar[str] = f"{HERE}:gone"
    phase: Literal["school.gone"] = "school.gone"


class Plugin:
    @hookimpl
    def neurorobo_register(self, registry: Registrar) -> None:
        registry.add("region", "school.scale", f"{HERE}:ScaleConfig")
        registry.add("data", "school.noise", f"{HERE}:NoiseConfig")
        registry.add("rule", "school.set", f"{HERE}:SetPhase")
        registry.add("rule", "school.pair", f"{HERE}:PairPhase")
        registry.add("rule", "school.gone", f"{HERE}:GonePhase")


FILE = """\
neurorobo: 1
name: school
time: {control: 1 s, window: 20}
episode: {duration: 1 s}
regions:
  pupil: {type: school.scale}
  other: {type: school.scale}
  add: {type: sum, unit: um}
steps:
  - sum: {use: add, a: previous sum.sum, b: previous sum.sum}
train:
  - {phase: supervise, region: pupil, teacher: {type: school.scale, gain: 2.0}, data: school.noise, loss: {y: 1 um}, steps: 150, learning_rate: 0.1, schedule: linear}
  - {phase: school.set, region: other, to: 7.0}
"""  # noqa: E501


def lessons(folder: Path, text: str = FILE) -> Any:
    file = folder / "school.yaml"
    file.write_text(text.replace("unit: um}", "unit: um, width: 2}"))
    types = Registry()
    types.add_plugin("school", Plugin())
    experiment = load_experiment(file, (), types)
    return experiment, read_lessons(experiment, types)


def train(folder: Path, text: str = FILE, **options: Any) -> Any:
    return train_experiment(*lessons(folder, text), folder / "out", **options)


def gain(folder: Path, region: str) -> float:
    with safe_open(folder / "out" / f"{region}.safetensors", "pt") as file:
        return float(file.get_tensor("gain.value"))


def refused(folder: Path, old: str, new: str, start: bool = False) -> str:
    assert old in FILE
    with pytest.raises(ConfigError) as caught:
        (train if start else lessons)(folder, FILE.replace(old, new, 1))
    assert not (folder / "out").exists()
    return str(caught.value)


def test_the_core_s_rule_and_a_plugin_s_run_from_one_file(tmp_path: Path) -> None:
    seen: list[int] = []
    reports = train(tmp_path, report=lambda index, progress: seen.append(index))
    assert (gain(tmp_path, "pupil"), gain(tmp_path, "other")) == (pytest.approx(2.0, abs=0.05), 7.0)
    assert [report.regions for report in reports] == [("pupil",), ("other",)]
    assert seen == [0] * 150 + [1]
    assert set(reports[0].evaluation) == {"rms", "largest", "bias", "firing_rates"}
    assert reports[1].evaluation == {}


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("gain: 2.0", "says: z", "train.0.loss.y: the teacher `school.scale` has no output `y`"),
        ("gain: 2.0", "unit: mm", "train.0.loss.y: the output `y` of the teacher `school.scale` is 2 x mm"),
        ("gain: 2.0", "reads: z", "train.0.teacher: `school.scale` reads `z`, which `pupil` has no input for"),
        ("gain: 2.0", "weights: w.safetensors", "train.0.teacher.weights: a teacher is built without weights"),
        ("region: other", "region: others", "train.1.region: there is no region `others`; did you mean `other`"),
        ("to: 7.0", "to: much", "train.1.to: must be a number (got 'much')"),
        ("to: 7.0", "to: 7.0, seed: 99999999999999999999", "train.1.seed: must be less than or equal to"),
    ],
)
def test_what_cannot_be_taught_is_told_before_anything_is_built(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    assert message in refused(tmp_path, old, new)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "steps: 150",
            "steps: 150, freeze: [gian]",
            "train.0.freeze.0: `pupil` has no parameter group `gian`; did you",
        ),
        ("data: school.noise", "data: {type: school.noise, broken: true}", "train.0.data: there is nothing to draw"),
        ("other: {type: school.scale", "other: {type: school.scale, gain: 101", "regions.other: cannot be built: a g"),
        ("gain: 2.0", "gain: 102", "train.0.teacher: cannot be built: a gain above 100 is too much"),
    ],
)
def test_what_only_the_built_regions_tell_is_told_before_any_phase_runs(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    assert message in refused(tmp_path, old, new, start=True)


def test_a_finished_phase_is_not_repeated_unless_its_settings_changed(tmp_path: Path) -> None:
    train(tmp_path)
    before = gain(tmp_path, "pupil")
    train(tmp_path, report=lambda index, progress: pytest.fail("trained again"))
    assert gain(tmp_path, "pupil") == before
    with pytest.raises(NeuroroboError, match=r"phase1_other.safetensors was trained by other settings than those of"):
        train(tmp_path, FILE.replace("to: 7.0", "to: 8.0"))
    (tmp_path / "out" / "phase1_other.safetensors").unlink()
    train(tmp_path, FILE.replace("to: 7.0", "to: 8.0"))
    assert gain(tmp_path, "other") == 8.0


def test_training_one_region_keeps_what_is_known_of_the_others(tmp_path: Path) -> None:
    train(tmp_path, only=["pupil"])
    report = tmp_path / "out" / "training.json"
    [first] = json.loads(report.read_text())["phases"]
    train(tmp_path, only=["other"])
    phases = json.loads(report.read_text())["phases"]
    assert [phase["regions"] for phase in phases] == [["pupil"], ["other"]]
    assert phases[0] == first


def test_a_region_that_no_phase_is_about_is_told_with_those_that_there_are(tmp_path: Path) -> None:
    with pytest.raises(NeuroroboError, match="no phase under `train` is about `cortex`; there are: other, pupil"):
        train(tmp_path, only=["pupil", "cortex"])


def test_an_interrupted_phase_goes_on_and_counts_all_its_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    straight, broken = tmp_path / "straight", tmp_path / "broken"
    for folder in (straight, broken):
        folder.mkdir()
    train(straight)

    def interrupt(index: int, progress: Progress) -> None:
        if progress.done == 20:
            signal.raise_signal(signal.SIGINT)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(Checkpoints, "seconds", property(lambda self: 100.0))
        train(broken, report=interrupt)
    first, _ = train(broken)
    assert first.seconds >= 100
    assert gain(broken, "pupil") == gain(straight, "pupil")
    assert list((broken / "out" / "checkpoints").iterdir()) == []


def test_a_checkpoint_outlives_weights_that_could_not_be_saved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_space(*_: object, **__: object) -> None:
        raise OSError("no space left")

    monkeypatch.setattr(train_module, "save_weights", no_space)
    monkeypatch.setattr(train_module, "Checkpoints", partial(Checkpoints, every_s=0))
    with pytest.raises(OSError):
        train(tmp_path)
    monkeypatch.undo()
    seen: list[int] = []
    train(tmp_path, report=lambda index, progress: seen.append(progress.done))
    assert seen == [1]  # the plugin's phase alone


TWICE = FILE.replace("region: other", "region: pupil") + "  - {phase: school.set, region: pupil, to: 3.0}\n"


def test_a_phase_is_tied_to_the_one_before_it(tmp_path: Path) -> None:
    train(tmp_path, TWICE)
    out = tmp_path / "out"
    first, second, third = (out / f"phase{i}_pupil.safetensors" for i in range(3))
    weights = first.read_bytes()
    first.unlink()
    with pytest.raises(NeuroroboError, match=r"phase1_pupil.safetensors goes on from phase0_pupil.safetensors, which"):
        train(tmp_path, TWICE, report=lambda *_: pytest.fail("trained before it was refused"))
    for file in (second, third):
        file.rename(file.with_suffix(".kept"))
    train(tmp_path, TWICE.replace("steps: 150", "steps: 140"))
    for file in (second, third):
        file.with_suffix(".kept").rename(file)
    with pytest.raises(NeuroroboError, match=r"phase1_pupil.safetensors was trained from other weights than the phase"):
        train(tmp_path, TWICE.replace("steps: 150", "steps: 140"))
    first.write_bytes(weights)
    train(tmp_path, TWICE, report=lambda *_: pytest.fail("trained again"))


def test_a_checkpoint_without_the_phase_before_it_is_refused(tmp_path: Path) -> None:
    (tmp_path / "out" / "checkpoints").mkdir(parents=True)
    (tmp_path / "out" / "checkpoints" / "phase1.safetensors").write_bytes(b"")
    with pytest.raises(
        NeuroroboError, match=r"phase1.safetensors goes on from phase0_pupil.safetensors, which is gone"
    ):
        train(tmp_path, TWICE)


def test_weights_that_do_not_say_how_they_were_trained_are_refused(tmp_path: Path) -> None:
    experiment, [lesson, _] = lessons(tmp_path)
    region = build_region(lesson.pupils["pupil"], experiment, torch.Generator())
    save_weights(region, tmp_path / "out" / "phase0_pupil.safetensors", {"phase": "0", "seconds": "1"})
    with pytest.raises(NeuroroboError, match="was trained by another version, which does not say how; remove it"):
        train(tmp_path)


@pytest.mark.parametrize("place", ["out", "out/checkpoints"])
def test_a_folder_that_cannot_be_written_is_named_before_any_phase_runs(tmp_path: Path, place: str) -> None:
    (tmp_path / place).parent.mkdir(exist_ok=True)
    (tmp_path / place).write_text("a file")
    with pytest.raises(NeuroroboError, match=rf"{place} cannot be written .*; make room for it, or choose another"):
        train(tmp_path, report=lambda *_: pytest.fail("trained before it was refused"))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "pupil: {type: school.scale}",
            "pupil: {type: school.scale, unit: foo}",
            "train.0.region: 'foo' is not a unit",
        ),
        ("{type: school.scale, gain: 2.0}", "{type: school.scale, unit: foo}", "train.0.teacher: 'foo' is not a unit"),
    ],
)
def test_ports_that_cannot_be_are_faults(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert message in refused(tmp_path, old, new)


def test_a_rule_that_cannot_be_imported_is_told_before_any_phase_runs(tmp_path: Path) -> None:
    message = refused(tmp_path, "phase: school.set, region: other, to: 7.0", "phase: school.gone, region: other", True)
    assert "train.1: `tests.experiment.test_train:gone` cannot be imported" in message


CART = """\
neurorobo: 1
name: loop
time: {control: 1 s, window: 20}
body: {type: toy.cart}
task: {type: toy.reach}
regions:
  driver: {type: toy.drive}
"""
LOOP = (
    CART
    + """\
  watcher: {type: toy.net}
  idle: {type: toy.net}
steps:
  - drive: {use: driver, position: body.position}
  - watch: {use: watcher, force: body.force}
command: {speed: drive.speed, nudge: drive.nudge}
train:
  - {phase: school.loop, region: watcher}
"""
)


class LoopPhase(RegionPhase):
    """A rule that acts once in the closed loop."""

    implementation: ClassVar[str] = f"{HERE}:act"
    phase: Literal["school.loop"] = "school.loop"

    @property
    def needs_rollout(self) -> bool:
        return True


met: list[Mapping[str, Tensor]] = []


def act(*, rollout: Rollout, report: Any, **_: object) -> None:
    met.append(rollout([3, 4]))
    report(Progress(1, 1, 0.0, {}, 0.0))


class LoopPlugin:
    @hookimpl
    def neurorobo_register(self, registry: Registrar) -> None:
        registry.add("rule", "school.loop", f"{HERE}:LoopPhase")
        Plugin().neurorobo_register(registry)


def types() -> Registry:
    registry = Registry()
    registry.add_plugin("toy", toys.Plugin())
    registry.add_plugin("school", LoopPlugin())
    return registry


def loop(folder: Path, text: str = LOOP, **options: Any) -> Experiment:
    file = folder / "loop.yaml"
    file.write_text(text)
    experiment = load_experiment(file, (), types())
    train_experiment(experiment, read_lessons(experiment, types()), folder / "out", **options)
    return experiment


def test_a_rule_can_let_its_region_act_in_the_closed_loop(tmp_path: Path) -> None:
    met.clear()
    experiment = loop(tmp_path)
    notes = toys.Notes()
    run_episodes(build_brain(experiment), build_task(experiment), [3, 4], recorders=[notes])
    force = np.concatenate([sample.observation["force"][sample.running] for sample in notes.samples])
    assert met[0]["force"].numpy() == pytest.approx(force.clip(-1, 1), abs=0.01 + 1 / 60)  # 6 neurons, 20 steps
    assert len(force) > 5


def test_a_region_that_takes_part_in_no_step_meets_nothing(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"train.0.region: `idle` takes part in no step"):
        loop(tmp_path, LOOP.replace("region: watcher", "region: idle"))


def test_the_others_act_with_the_weights_that_the_file_names(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"regions.driver.weights: .*absent.safetensors"):
        loop(tmp_path, LOOP.replace("toy.drive", "toy.drive, weights: absent.safetensors"))


ACTING = (
    CART
    + """\
  other: {type: school.scale, unit: mN}
  pupil: {type: school.scale}
steps:
  - drive: {use: driver, position: body.position}
  - scale: {use: other, x: body.force}
  - watch: {use: pupil, x: scale.y}
  - watch_again: {use: pupil, x: body.force}
command: {speed: drive.speed, nudge: drive.nudge}
train:
  - {phase: school.set, region: other, to: 7.0}
  - {phase: school.loop, region: pupil}
"""
)
TEACHING = (
    "{phase: supervise, region: pupil, teacher: {type: school.scale, gain: 2.0}, data: school.noise, "
    "loss: {y: 1 um}, steps: 40, batch: 8, on_policy: {share: 0.5, episodes: 2, every: 7, keep: 2}}"
)
SUPERVISED = ACTING.replace("{phase: school.loop, region: pupil}", TEACHING)


def test_the_others_act_with_what_earlier_phases_taught_them(tmp_path: Path) -> None:
    met.clear()
    for name, text in (("taught", ACTING), ("untaught", ACTING.replace("region: other", "region: pupil"))):
        (tmp_path / name).mkdir()
        loop(tmp_path / name, text.replace("  - watch_again: {use: pupil, x: body.force}\n", ""))
    taught, untaught = (values["x"] for values in met)
    assert not untaught.any()  # a gain of zero
    met.clear()
    loop(tmp_path, ACTING.replace("to: 7.0", "to: 1.0").replace("  - watch_again: {use: pupil, x: body.force}\n", ""))
    assert taught.any()
    torch.testing.assert_close(taught, 7.0 * met[0]["x"])


def test_a_region_meets_what_each_of_its_steps_is_given(tmp_path: Path) -> None:
    met.clear()
    loop(tmp_path, ACTING)
    one_tick = 4  # two episodes of two steps
    scaled, plain = met[0]["x"][:one_tick].split(2)
    torch.testing.assert_close(scaled, 7.0 * plain)


def test_an_interrupted_phase_that_acts_ends_with_the_very_same_weights(tmp_path: Path) -> None:
    def interrupt(index: int, progress: Progress) -> None:
        if index == 1 and progress.done in (10, 21):  # inside a visit's time, and at its end
            signal.raise_signal(signal.SIGINT)

    straight, broken = tmp_path / "straight", tmp_path / "broken"
    for folder in (straight, broken):
        folder.mkdir()
    loop(straight, SUPERVISED)
    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            loop(broken, SUPERVISED, report=interrupt)
    loop(broken, SUPERVISED)
    assert gain(broken, "pupil") == gain(straight, "pupil") != 0.0
    one, other = (folder / "out" / "pupil.safetensors" for folder in (straight, broken))
    assert one.read_bytes() == other.read_bytes()


def test_a_finished_phase_is_tied_to_the_loop_in_which_it_acted(tmp_path: Path) -> None:
    loop(tmp_path, SUPERVISED)
    loop(tmp_path, SUPERVISED.replace("name: loop", "name: renamed"))  # which changes nothing that it meets
    with pytest.raises(NeuroroboError, match=r"phase1_pupil.safetensors was trained in another closed loop: body"):
        loop(tmp_path, SUPERVISED.replace("toy.cart", "toy.cart, noise: 0.5"))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("share: 0.5", "share: 0.05", "train.1.on_policy.share: 0.05 of a batch of 8 is none or all; make the batch"),
        ("share: 0.5", "share: 0.99", "train.1.on_policy.share: 0.99 of a batch of 8 is none or all; make the batch"),
        (
            "pupil: {type: school.scale}",
            "pupil: {type: school.scale, carry: always}",
            "train.1.on_policy: `pupil` carr",
        ),
    ],
)
def test_what_cannot_act_is_told_before_anything_is_built(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in SUPERVISED
    with pytest.raises(ConfigError, match=re.escape(message)):
        loop(tmp_path, SUPERVISED.replace(old, new))
    assert not (tmp_path / "out").exists()


def test_a_note_tells_of_spiking_regions_that_act_untrained(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = ACTING.replace("  pupil:", "  watcher: {type: toy.net}\n  pupil:")
    loop(tmp_path, text.replace("command:", "  - look: {use: watcher, force: body.force}\ncommand:"))
    assert "note: train.1: `watcher` has no `weights` and learns later or not at all" in capsys.readouterr().err


class PairPhase(Phase):
    """A rule of a plugin's own for several regions: it adds to each gain."""

    implementation: ClassVar[str] = f"{HERE}:add_to_gains"
    from_weights: ClassVar[bool] = True
    phase: Literal["school.pair"] = "school.pair"
    regions: tuple[str, ...]
    add: float

    @property
    def pupils(self) -> Mapping[str, tuple[str | int, ...]]:
        return {name: ("regions", index) for index, name in enumerate(self.regions)}


def add_to_gains(*, regions: Mapping[str, Region], phase: PairPhase, report: Any, **_: object) -> Mapping[str, Any]:
    with torch.no_grad():
        for region in regions.values():
            region.get_parameter("gain.value").add_(phase.add)
    report(Progress(1, 1, 0.0, {}, 0.0))
    return {"gains": [region.get_parameter("gain.value").item() for region in regions.values()]}


PAIR = FILE.replace("region: other, to: 7.0", "region: pupil, to: 7.0") + (
    "  - {phase: school.pair, regions: [pupil, other], add: 1.0}\n"
)


def test_a_phase_may_train_several_regions_and_go_on_from_the_weights_of_the_file(tmp_path: Path) -> None:
    file = PAIR.replace("other: {type: school.scale", "other: {type: school.scale, weights: other.safetensors")
    experiment, [lesson, *_] = lessons(tmp_path, file)
    region = build_region(lesson.pupils["pupil"], experiment, torch.Generator())
    with torch.no_grad():
        region.get_parameter("gain.value").fill_(3.0)
    save_weights(region, tmp_path / "other.safetensors", {})
    [*single, both] = train(tmp_path, file)
    assert both.regions == ("pupil", "other")
    assert both.evaluation == {"gains": [8.0, 4.0]}  # the one from the phase before, the other from its weights
    assert (gain(tmp_path, "pupil"), gain(tmp_path, "other")) == (8.0, 4.0)
    assert train(tmp_path, file) == [*single, both]  # what a rule has found outlives it
    with torch.no_grad():
        region.get_parameter("gain.value").fill_(2.0)
    save_weights(region, tmp_path / "other.safetensors", {})
    with pytest.raises(NeuroroboError, match=r"phase2_.*safetensors was trained from other weights"):
        train(tmp_path, file)


def test_every_region_that_there_is_not_is_told_at_its_place(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"train.2.regions.1: there is no region `othre`; did you mean `other`"):
        lessons(tmp_path, PAIR.replace("[pupil, other]", "[pupil, othre]"))
