"""Tasks as Gymnasium sees them: one at a time, and many side by side."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv
from gymnasium.wrappers.vector import RecordEpisodeStatistics

from neurorobo.errors import NeuroroboError
from neurorobo.tasks.env import TaskEnv, TaskVectorEnv
from tests.tasks.toys import reach

SECOND = 1_000_000_000


@contextmanager
def only_warnings_about(*words: str) -> Iterator[None]:
    """Every other warning stays an error."""
    with warnings.catch_warnings():
        for word in words:
            warnings.filterwarnings("ignore", message=f"(?s).*{word}")
        yield


def one() -> TaskEnv:
    return TaskEnv(reach, period_ns=SECOND)


def many(count: int = 3) -> TaskVectorEnv:
    return TaskVectorEnv(reach, count, period_ns=SECOND)


def actions(env: VectorEnv, steps: int, forward: float = 0.3) -> Iterator[dict[str, np.ndarray]]:
    """Random actions that roll forward more than back, so that some episodes reach the goal and some do not."""
    env.action_space.seed(4)
    for _ in range(steps):
        action = env.action_space.sample()
        action["speed"] = np.clip(action["speed"] + np.float32(forward), -1, 1)
        action["nudge"] *= np.float32(0.5)
        yield action


def test_the_single_environment_passes_gymnasiums_checker() -> None:
    check_env(one(), skip_render_check=True)  # there is nothing to render; spaces here are bounded, so nothing warns


def test_the_vector_environment_is_a_batch_of_single_ones() -> None:
    """Gymnasium's own vectorisation of three single environments is the reference for all that a batch returns."""
    ours = many()
    reference = SyncVectorEnv([one] * 3, autoreset_mode=AutoresetMode.SAME_STEP)
    assert ours.single_observation_space == reference.single_observation_space
    assert ours.observation_space == reference.observation_space
    assert ours.action_space == reference.action_space
    assert data_equivalence(ours.reset(seed=5), reference.reset(seed=5), exact=True)
    ends = []
    for action in actions(ours, 60):
        found, expected = ours.step(action), reference.step(action)
        assert data_equivalence(found, expected, exact=True), (found, expected)
        ends += [found[2:4]] if (found[2] | found[3]).any() else []
    terminated, truncated = np.sum(ends, axis=0)
    assert terminated.sum() >= 3  # both kinds of end were met, at different times
    assert truncated.sum() >= 1
    assert any(0 < (end[0] | end[1]).sum() < 3 for end in ends)


def test_observations_and_actions_fit_their_spaces() -> None:
    env = many()
    assert env.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    observation, info = env.reset(seed=1)
    assert observation in env.observation_space
    assert info == {}
    assert {name: value.shape for name, value in observation.items()} == {"force": (3, 2), "position": (3, 2)}
    for action in actions(env, 20):
        observation, reward, terminated, truncated, _ = env.step(action)
        assert observation in env.observation_space
        assert (reward.shape, reward.dtype) == ((3,), np.float64)
        assert {flags.dtype for flags in (terminated, truncated)} == {np.dtype(np.bool_)}


def test_an_end_comes_with_the_last_observation_the_metrics_and_the_interventions() -> None:
    env = TaskVectorEnv(lambda: reach(noise=0.0), 2, period_ns=SECOND)
    env.reset(seed=0)
    action = {"speed": np.float32([[0.5], [0.9]]), "nudge": np.float32([[0, 0], [0.3, 4.0]])}
    for _ in range(2):
        env.step(action)
    observation, reward, terminated, truncated, info = env.step(action)
    assert terminated.tolist() == [False, True]
    assert truncated.tolist() == [False, False]
    assert reward == pytest.approx([-1.5, 0.6])
    assert info["_final_obs"].tolist() == info["_final_info"].tolist() == [False, True]
    assert info["final_obs"][0] is None
    assert info["final_obs"][1]["position"] == pytest.approx([3.6, 3.0])
    assert {name: value[1] for name, value in info["final_info"].items() if name[0] != "_"} == pytest.approx(
        {"duration_s": 3.0, "success": 1.0, "error_um": 0.6, "command_interventions": 3.0}
    )
    assert observation["position"] == pytest.approx(np.array([[1.5, 0.0], [0.0, 0.0]]))
    env.step(action)
    env.step(action)
    *_, info = env.step(action)
    assert info["final_info"]["command_interventions"][1] == 3.0  # counted anew for the new episode


def rollout(env: TaskVectorEnv, steps: int) -> list[np.ndarray]:
    return [env.step(action)[0]["position"] for action in actions(env, steps)]


def test_equal_seeds_give_equal_episodes_also_after_the_first_end() -> None:
    env = many()
    first, second, third = [(env.reset(seed=seed), rollout(env, 40)) for seed in (1, 1, 2)]
    assert data_equivalence(first, second, exact=True)
    assert not np.array_equal(first[1][0], third[1][0])


def test_seeds_can_be_given_one_by_one_and_none_goes_on_with_the_sequence() -> None:
    env = many()
    by_number, _ = env.reset(seed=7)
    one_by_one, _ = env.reset(seed=[7, 8, 9])
    assert data_equivalence(by_number, one_by_one, exact=True)
    again, _ = env.reset()
    assert not np.array_equal(again["position"], one_by_one["position"])
    env.reset(seed=7)
    same_again, _ = env.reset()
    assert data_equivalence(again, same_again, exact=True)
    mixed, _ = env.reset(seed=[7, None, 9])
    assert np.array_equal(mixed["position"][[0, 2]], by_number["position"][[0, 2]])
    assert not np.array_equal(mixed["position"][1], by_number["position"][1])


def test_gymnasiums_vector_wrappers_work() -> None:
    env = RecordEpisodeStatistics(many())
    env.reset(seed=1)
    episodes = [info["episode"] for action in actions(env, 40) if "episode" in (info := env.step(action)[4])]
    lengths = np.concatenate([episode["l"] for episode in episodes])
    assert 1 < lengths[lengths > 0].mean() <= 8


def test_an_action_that_is_no_number_is_refused() -> None:
    env = one()
    env.reset(seed=0)
    with pytest.raises(NeuroroboError, match="the command `speed` is nan"):
        env.step({"speed": np.float32([np.nan]), "nudge": np.zeros(2, np.float32)})


def test_closing_stops_the_body_and_then_closes_it(monkeypatch: pytest.MonkeyPatch) -> None:
    env = many()
    env.reset(seed=0)
    stopped_when_closed = []
    monkeypatch.setattr(env.body, "close", lambda: stopped_when_closed.append(env.body.stopped))
    env.close()
    env.close()
    assert stopped_when_closed == [1]


def test_the_insertion_task_passes_too() -> None:
    """The bundled task; its ranges are physical, which Gymnasium's checker would rather have normalised."""
    from precision_interaction.rig.insertion_rig import InsertionRig
    from precision_interaction.rig.insertion_rig_config import InsertionRigConfig
    from precision_interaction.rig.insertion_task import InsertionTask
    from precision_interaction.rig.insertion_task_config import InsertionTaskConfig

    def insertion() -> InsertionTask:
        rig = InsertionRig(InsertionRigConfig(type="precision.insertion_rig"))
        return InsertionTask(InsertionTaskConfig(type="precision.insertion"), rig)

    def single() -> gymnasium.Env:
        return TaskEnv(insertion, period_ns=SECOND)

    with only_warnings_about("infinity", "normalized"):
        check_env(single(), skip_render_check=True)
    ours = TaskVectorEnv(insertion, 2, period_ns=SECOND)
    reference = SyncVectorEnv([single] * 2, autoreset_mode=AutoresetMode.SAME_STEP)
    assert data_equivalence(ours.reset(seed=1000), reference.reset(seed=1000), exact=True)
    ours.action_space.seed(1)
    ended = 0
    for _ in range(130):
        action = ours.action_space.sample()
        found, expected = ours.step(action), reference.step(action)
        assert data_equivalence(found, expected, exact=True)
        ended += found[2].sum() + found[3].sum()
    assert ended >= 2
