"""The reward and the end of a Gymnasium environment, in the closed loop of a file."""

from pathlib import Path

import gymnasium
import numpy as np
import pytest

from neurorobo.bodies.gymnasium_body import GymnasiumBody
from neurorobo.bodies.gymnasium_body_config import GymnasiumBodyConfig
from neurorobo.config.experiment import load_experiment
from neurorobo.errors import NeuroroboError
from neurorobo.experiment.build import build_brain, build_task
from neurorobo.experiment.closed_loop import run_episodes
from neurorobo.tasks.gymnasium_task import GymnasiumTask
from neurorobo.tasks.gymnasium_task_config import GymnasiumTaskConfig
from tests.tasks.toys import Cart, CartConfig

FILE = """\
neurorobo: 1
name: balance
seed: 3
time: {control: 20 ms, spike_step: 1 ms, window: 8}
body:
  type: gymnasium_environment
  environment: CartPole-v1
  sensors: {pole: {elements: [2, 3], range: -2..2}}
task: gymnasium_reward
regions:
  controller:
    type: dense_network
    inputs: {pole: {unit: "1", width: 2, range: -2..2}}
    outputs: {action: {unit: "1", width: 2, range: -1..1}}
    hidden: [8]
steps:
  - act: {use: controller, pole: body.pole}
command: {action: act.action}
"""


def test_a_file_runs_an_environment_and_an_episode_depends_on_its_seed_alone(tmp_path: Path) -> None:
    file = tmp_path / "balance.yaml"
    file.write_text(FILE)
    experiment = load_experiment(file)
    brain, task = build_brain(experiment), build_task(experiment)
    together = [result.metrics for result in run_episodes(brain, task, range(5))]
    alone = [run_episodes(brain, task, [seed])[0].metrics for seed in range(5)]
    assert together == alone
    assert len({metrics["return"] for metrics in together}) > 1
    for metrics in together:  # a reward of one at each step, until the pole falls
        assert metrics["return"] == metrics["steps"] > 5.0


def test_it_ends_when_the_environment_does() -> None:
    body_config = GymnasiumBodyConfig.model_validate(
        {"environment": "CartPole-v1", "sensors": {"state": {"range": "-9..9"}}, "kwargs": {"max_episode_steps": 12}}
    )
    task = GymnasiumTask(GymnasiumTaskConfig(), body := GymnasiumBody(body_config))
    body.reset([0, 1])
    task.reset(2)
    alone = gymnasium.make("CartPole-v1", max_episode_steps=12)
    alone.reset(seed=1)
    push_right = {"action": np.tile([0.0, 1.0], (2, 1))}
    ended = False
    while not ended:
        running = ~(task.terminated() | task.truncated())
        body.advance(push_right, 20_000_000)
        task.observe(20_000_000, running)
        _, reward, terminated, truncated, _ = alone.step(1)
        assert (task.reward()[1], task.terminated()[1], task.truncated()[1]) == (reward, terminated, truncated)
        ended = terminated or truncated
    assert task.metrics()[1]["steps"] < 12
    again = np.array([False, True])
    body.reset([1], again)
    task.reset(2, again)
    assert task.metrics()[1] == {"return": 0.0, "steps": 0.0}
    assert task.metrics()[0]["steps"] > 5.0
    assert not task.terminated()[1]


def test_another_body_is_refused() -> None:
    with pytest.raises(NeuroroboError, match="take that as the body"):
        GymnasiumTask(GymnasiumTaskConfig(), Cart(CartConfig(type="toy.cart")))  # type: ignore[arg-type]
