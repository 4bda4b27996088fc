"""PPO in the closed loop: what is explored, what is learned, what an interruption leaves, and what is refused."""

import json
import signal
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file
from torch import Tensor

from neurorobo.clock import Clock
from neurorobo.codes import PopulationUniform
from neurorobo.config.experiment import Experiment, load_experiment
from neurorobo.errors import ConfigError, NeuroroboError
from neurorobo.experiment.build import build_brain, build_task
from neurorobo.experiment.closed_loop import run_episodes
from neurorobo.experiment.lessons import read_lessons
from neurorobo.experiment.plan import build_plan
from neurorobo.experiment.practice import Practice
from neurorobo.experiment.train import train_experiment
from neurorobo.learning.actor import Actor
from neurorobo.learning.experience import Performance
from neurorobo.learning.supervise import Progress
from neurorobo.plugins import Registrar, Registry, hookimpl
from neurorobo.regions import Port
from neurorobo.regions.region import Probe, State
from tests.experiment import toys
from tests.regions.toys import Net, NetConfig
from tests.tasks.toys import Reach

HERE = "tests.experiment.test_ppo"


class PilotConfig(NetConfig):
    """The small spiking network with everything that regions have, as one that commands a speed."""

    implementation: ClassVar[str] = f"{HERE}:Pilot"
    type: Literal["test.pilot"] = "test.pilot"  # type: ignore[assignment]

    def outputs(self, clock: Clock) -> dict[str, Port]:
        return {"speed": Port("um/s", code=PopulationUniform(self.neurons, 0.0, 1.0))}


class Pilot(Net):
    def step(
        self, inputs: Mapping[str, Tensor], state: State, probe: Probe | None = None
    ) -> tuple[dict[str, Tensor], State]:
        outputs, after = super().step(inputs, state, probe)
        return {"speed": outputs["move"]}, after


class Plugin:
    @hookimpl
    def neurorobo_register(self, registry: Registrar) -> None:
        registry.add("region", "test.pilot", f"{HERE}:PilotConfig")


GOAL_UM = 5.0
FILE = """\
neurorobo: 1
name: cart
seed: 3
time: {control: 1 s, spike_step: 1 ms, window: 20}
body: {type: toy.cart, noise: 0.1}
task: {type: toy.reach, goal_um: 5.0}
regions:
  pilot: {type: test.pilot, carry: always}
  driver: {type: toy.drive}
steps:
  - drive: {use: driver, position: body.position}
  - steer: {use: pilot, force: body.force}
command: {speed: steer.speed, nudge: drive.nudge}
train:
  - {phase: ppo, regions: {pilot: [output]}, explore: {speed: 0.1 um/s}, iterations: 8, episodes: 16, minibatch: 32,
     epochs: 3, learning_rate: 0.03, validation: {episodes: 8, every: 2}, held_out: {episodes: 8}}
"""


def types() -> Registry:
    registry = toys.registry()
    registry.add_plugin("test", Plugin())
    return registry


def load(folder: Path, text: str = FILE) -> Experiment:
    folder.mkdir(exist_ok=True)
    file = folder / "cart.yaml"
    file.write_text(text)
    return load_experiment(file, (), types())


def train(folder: Path, text: str = FILE, **options: Any) -> Any:
    experiment = load(folder, text)
    [report] = train_experiment(experiment, read_lessons(experiment, types()), folder / "out", **options)
    return report


def practice(folder: Path) -> Practice:
    experiment = load(folder)
    return Practice(experiment, build_plan(experiment), ["pilot"], {})


DEVIATIONS = {"speed": 0.1}


@pytest.mark.parametrize("trained", [False, True], ids=["fresh", "weights off every grid"])
def test_run_again_a_spiking_region_says_exactly_what_it_said_with_the_state_that_it_had(
    tmp_path: Path, trained: bool
) -> None:
    loop = practice(tmp_path)
    pilot = loop.brain.region("pilot")
    if trained:
        with torch.no_grad():
            for parameter in pilot.parameters():
                parameter.mul_(1 + 0.05 * torch.rand(parameter.shape, generator=torch.Generator().manual_seed(1)))
    experience = loop.explore(range(20), DEVIATIONS)  # more than one batch
    ticks, episodes = experience.running.nonzero(as_tuple=True)
    order = torch.randperm(len(ticks), generator=torch.Generator().manual_seed(2))[:50]
    ticks, episodes = ticks[order], episodes[order]
    actor = Actor({"pilot": pilot}, loop.plan, DEVIATIONS)
    again = actor.means(experience, ticks, episodes)
    assert again.requires_grad
    assert (again == experience.mean[ticks, episodes]).all()  # so that every ratio is exactly one
    assert again.std() > 0
    for windows in experience.windows.values():
        for state in windows.state.values():
            state.zero_()
    assert (actor.means(experience, ticks, episodes) != experience.mean[ticks, episodes]).any()


def test_what_is_explored_hangs_on_the_seed_alone_and_is_as_wide_as_it_was_asked_for(tmp_path: Path) -> None:
    loop = practice(tmp_path)
    experience = loop.explore(range(20), DEVIATIONS)
    alone = loop.explore([17], DEVIATIONS)
    length = len(alone.running)
    assert torch.equal(alone.command[:, 0], experience.command[:length, 17])
    assert torch.equal(alone.reward[:, 0], experience.reward[:length, 17])
    assert not experience.running[length:, 17].any()
    tried = (experience.command - experience.mean)[experience.running]
    assert tried.std().item() == pytest.approx(0.1, rel=0.2)
    assert abs(tried.mean().item()) < 0.03


def test_each_tick_knows_what_was_observed_before_and_after_it(tmp_path: Path) -> None:
    experience = practice(tmp_path).explore(range(3), DEVIATIONS)
    together = experience.running[1:]
    torch.testing.assert_close(experience.following[:-1][together], experience.observation[1:][together])
    assert not experience.truncated.sum(0).gt(1).any()
    last = experience.running & ~torch.cat([together, torch.zeros(1, 3, dtype=torch.bool)])
    position = experience.following[last][:, 2]  # force, position, time
    assert torch.equal(experience.truncated[last], position < GOAL_UM)


def test_without_exploring_the_return_is_that_of_a_plain_run(tmp_path: Path) -> None:
    loop = practice(tmp_path)
    found = loop.perform(range(18))
    brain, task = build_brain(load(tmp_path)), build_task(load(tmp_path))
    assert task is not None
    notes = toys.Notes()
    [result] = run_episodes(brain, task, [17], recorders=[notes])
    positions_um = [
        *(sample.observation["position"][0, 0] for sample in notes.samples),
        task.body.read()["position"][0, 0],
    ]
    assert found.returns[17] == pytest.approx(sum(position_um - GOAL_UM for position_um in positions_um[1:]))
    assert found.metrics[17] == result.metrics


def test_it_learns_to_be_quick_and_tells_what_it_gained(tmp_path: Path) -> None:
    seen: list[Progress] = []
    report = train(tmp_path, report=lambda index, progress: seen.append(progress))
    before, after = (report.evaluation["held_out"][when] for when in ("before", "after"))
    assert np.mean(after["return"]) > np.mean(before["return"]) + 1.0
    assert np.mean(after["duration_s"]) < np.mean(before["duration_s"]) - 0.3
    assert len(report.evaluation["learning_curve"]) == 8 == len(seen)
    assert [done for done, _ in report.evaluation["validation"]] == [0, 2, 4, 6, 8]
    assert set(seen[-1].error) == {"return", "validation"}
    found = load(tmp_path / "after", FILE.replace("always}", f"always, weights: {tmp_path}/out/pilot.safetensors}}"))
    again = Practice(found, build_plan(found), ["pilot"], {}).perform(range(8))
    assert again.returns == after["return"]


def test_what_no_iteration_has_bettered_stays_as_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    count = iter(range(100))
    monkeypatch.setattr(Practice, "perform", lambda self, seeds: Performance([-next(count)], [{}]))
    train(tmp_path, FILE.replace("iterations: 8", "iterations: 2"))
    found = load(tmp_path / "after", FILE.replace("always}", f"always, weights: {tmp_path}/out/pilot.safetensors}}"))
    fresh = load(tmp_path)
    experiment_seed = torch.Generator().manual_seed(0)  # the phase's, with which an untrained region begins
    start = Pilot(fresh.regions["pilot"], fresh.clock, experiment_seed).state_dict()  # type: ignore[arg-type]
    kept = build_brain(found).region("pilot").state_dict()
    assert all(torch.equal(kept[name], tensor) for name, tensor in start.items())


def iterations_done(folder: Path) -> int:
    with safe_open(folder / "out" / "checkpoints" / "phase0.safetensors", "pt") as file:
        done: int = json.loads(file.metadata()["checkpoint"])["done"]
    return done


def test_an_interrupted_phase_ends_with_the_very_same_weights_and_figures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = FILE.replace("iterations: 8", "iterations: 4")
    straight = train(tmp_path / "straight", text)

    def stop(index: int, progress: Progress) -> None:
        if progress.done == 1:
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):  # between two iterations
        train(tmp_path / "broken", text, report=stop)
    assert iterations_done(tmp_path / "broken") == 1
    explore = Practice.explore

    def torn(self: Practice, *arguments: Any) -> Any:
        experience = explore(self, *arguments)
        calls.append(1)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return experience

    calls: list[int] = []
    monkeypatch.setattr(Practice, "explore", torn)
    with pytest.raises(KeyboardInterrupt):  # in the middle of one
        train(tmp_path / "broken", text)
    assert iterations_done(tmp_path / "broken") == 2
    broken = train(tmp_path / "broken", text)
    assert json.dumps(broken.evaluation) == json.dumps(straight.evaluation)
    files = [tmp_path / name / "out" / "phase0_pilot.safetensors" for name in ("straight", "broken")]
    tensors = [load_file(file) for file in files]
    assert all(torch.equal(tensors[0][name], tensors[1][name]) for name in tensors[0])
    assert json.loads((tmp_path / "broken" / "out" / "training.json").read_text())["phases"][0]["regions"] == ["pilot"]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("speed: 0.1 um/s}", "sped: 0.1 um/s}", "train.0.explore.sped: the body has no actuator `sped`; did you mean"),
        ("speed: 0.1 um/s}", "speed: 0.1 mN}", "train.0.explore.speed: "),
        ("speed: 0.1 um/s}", "speed: 0 um/s}", "train.0.explore.speed: a standard deviation is above zero (got '0 um"),
        ("speed: 0.1 um/s}", "nudge: 0.1 um}", "train.0.explore.nudge: comes from `drive`, whose region `driver` does"),
        ("{pilot: [output]}", "{pilot: []}", "train.0.regions.pilot: name the parameter groups to train"),
        ("{pilot: [output]}", "{pilto: [output]}", "train.0.regions.pilto: there is no region `pilto`; did you mean"),
        (
            "{pilot: [output]}",
            "{pilot: [output], driver: [gain]}",
            "train.0.regions.driver: no step of `driver` gives a command under `explore`; leave it out",
        ),
        (
            "  - steer:",
            "  - steer_first: {use: pilot, force: body.force}\n  - steer:",
            "train.0.regions.pilot: `pilot` carries its state through 2 steps",
        ),
        ("iterations: 8", "iterations: 0", "train.0.iterations: must be greater than or equal to 1"),
        (
            "held_out: {episodes: 8}",
            "held_out: {first_seed: 1007, episodes: 8}",
            "train.0: the seeds of `held_out`",
        ),
        (
            "every: 2}",
            "every: 2, first_seed: 999993}",
            "train.0.validation: seeds from 1000000 on are those of training",
        ),
        (
            "iterations: 8",
            "iterations: 8, critic: {hidden: [-1]}",
            "train.0.critic.hidden.0: must be greater",
        ),
    ],
)
def test_what_cannot_be_learned_is_told_before_anything_is_built(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    assert old in FILE
    with pytest.raises(ConfigError) as caught:
        read_lessons(load(tmp_path, FILE.replace(old, new, 1)), types())
    assert message in str(caught.value)


def test_groups_that_there_are_not_are_told_before_training(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"train.0.regions.pilot.0: `pilot` has no parameter group `outptu`; did you"):
        train(tmp_path, FILE.replace("[output]", "[outptu]"))
    assert not (tmp_path / "out").exists()


def test_a_loop_without_a_body_has_no_reward_to_learn_from(tmp_path: Path) -> None:
    text = FILE.replace(
        "body: {type: toy.cart, noise: 0.1}\ntask: {type: toy.reach, goal_um: 5.0}\n", "episode: {duration: 3 s}\n"
    )
    text = text.replace("force: body.force", "").replace(", position: body.position", "")
    text = text.replace("  - drive: {use: driver}\n", "").replace(
        "command: {speed: steer.speed, nudge: drive.nudge}\n", ""
    )
    with pytest.raises(ConfigError, match=r"train.0.phase: needs a `body` and a `task`, whose reward it learns from"):
        read_lessons(load(tmp_path, text), types())


def test_an_iteration_ends_when_the_policy_has_gone_far_enough(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The first step of learning finds the policy where it was; the second one would be too far from there."""
    learned: list[Tensor] = []
    plain = torch.optim.Adam.step

    def counted(self: torch.optim.Adam, closure: Any = None) -> Any:
        learned.append(torch.zeros(()))
        return plain(self, closure)

    monkeypatch.setattr(torch.optim.Adam, "step", counted)
    report = train(tmp_path, FILE.replace("iterations: 8", "iterations: 2, target_kl: 1e-12"))
    assert len(learned) == 2 * 2  # actor and critic, in each iteration
    assert all(kl > 1.5e-12 for kl in report.evaluation["kl"])


def test_a_reward_that_is_no_number_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Reach, "reward", lambda self: np.full(len(self.terminated()), np.nan))
    with pytest.raises(NeuroroboError, match="Reach gives a reward of nan, of which nothing can be learned"):
        practice(tmp_path).explore([1], DEVIATIONS)
    with pytest.raises(NeuroroboError, match="Reach gives a reward of nan"):
        practice(tmp_path).perform([1])


def test_what_ends_by_itself_when_time_is_up_has_no_future(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Reach, "truncated", lambda self: self.terminated())
    assert not practice(tmp_path).explore(range(8), DEVIATIONS).truncated.any()
