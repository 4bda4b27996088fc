"""PPO's numbers: advantages, losses and gradients against Stable-Baselines3, and the critic's units."""

from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from neurorobo.learning.actor import log_probability
from neurorobo.learning.critic import Critic
from neurorobo.learning.experience import Experience, advantages
from neurorobo.learning.ppo import losses, normalised
from neurorobo.learning.ppo_config import CriticConfig

stable_baselines3 = pytest.importorskip("stable_baselines3", reason="of the extra `dev`")
gymnasium = pytest.importorskip("gymnasium")

LENGTHS = (5, 8, 3, 8)
TRUNCATED = (False, True, True, False)
DISCOUNT, LAMBDA, CLIP = 0.93, 0.8, 0.2


def random(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


def ragged() -> Experience:
    """Four episodes of unequal length; two were truncated. What stands behind their ends is no number."""
    ticks, episodes = max(LENGTHS), len(LENGTHS)
    running = torch.arange(ticks)[:, None] < torch.tensor(LENGTHS)
    last = torch.arange(ticks)[:, None] == torch.tensor(LENGTHS) - 1
    nothing = torch.zeros(ticks, episodes, 1)
    reward = torch.where(running, random(ticks, episodes), 0.0)
    truncated = last & torch.tensor(TRUNCATED)
    return Experience(nothing, nothing, reward, running, truncated, nothing, nothing, nothing, {}, 0.0)


def test_advantages_of_episodes_of_any_length_are_those_of_stable_baselines3() -> None:
    from stable_baselines3.common.buffers import RolloutBuffer

    experience = ragged()
    value = random(*experience.reward.shape, seed=1)
    following = torch.cat([value[1:], random(1, len(LENGTHS), seed=2)])
    box = gymnasium.spaces.Box(-1, 1, (1,))
    buffer = RolloutBuffer(sum(LENGTHS), box, box, gae_lambda=LAMBDA, gamma=DISCOUNT)
    for episode, length in enumerate(LENGTHS):
        for tick in range(length):
            reward = float(experience.reward[tick, episode])
            if experience.truncated[tick, episode]:  # as its `collect_rollouts` does
                reward += DISCOUNT * float(following[tick, episode])
            buffer.add(
                np.zeros((1, 1)),
                np.zeros((1, 1)),
                np.array([reward]),
                np.array([tick == 0]),
                value[tick, episode][None],
                torch.zeros(1),
            )
    buffer.compute_returns_and_advantage(torch.zeros(1), np.array([True]))
    found = advantages(experience, value, following, discount=DISCOUNT, gae_lambda=LAMBDA)
    assert (found[~experience.running] == 0).all()
    ours = torch.cat([found[:length, episode] for episode, length in enumerate(LENGTHS)])
    np.testing.assert_allclose(ours, buffer.advantages[:, 0], rtol=1e-5, atol=1e-6)
    returns = torch.cat([(found + value)[:length, episode] for episode, length in enumerate(LENGTHS)])
    np.testing.assert_allclose(returns, buffer.returns[:, 0], rtol=1e-5, atol=1e-6)


def test_without_discount_and_critic_the_advantage_is_the_reward_that_follows() -> None:
    experience = ragged()
    nothing = torch.zeros_like(experience.reward)
    found = advantages(experience, nothing, nothing, discount=1.0, gae_lambda=1.0)
    torch.testing.assert_close(found[0], experience.reward.sum(0))
    torch.testing.assert_close(experience.returns(1.0)[1], found[experience.running])


class Still(gymnasium.Env):  # type: ignore[misc, name-defined]
    """Three numbers to see, two to choose."""

    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (3,))
    action_space = gymnasium.spaces.Box(-1, 1, (2,))

    def reset(self, **_: Any) -> Any:
        return np.zeros(3, np.float32), {}

    def step(self, action: Any) -> Any:
        return np.zeros(3, np.float32), 0.0, False, False, {}


def test_losses_and_gradients_are_those_of_stable_baselines3(monkeypatch: pytest.MonkeyPatch) -> None:
    from stable_baselines3.common.logger import configure

    count, spread = 64, torch.tensor([0.3, 0.7])
    model = stable_baselines3.PPO(
        "MlpPolicy",
        Still(),
        learning_rate=0.0,  # the gradients stay as they are
        n_steps=count,
        batch_size=count,
        n_epochs=1,
        clip_range=CLIP,
        vf_coef=1.0,
        ent_coef=0.0,
        max_grad_norm=np.inf,
        seed=0,
        device="cpu",
    )
    model.set_logger(configure(None, []))
    policy = model.policy
    with torch.no_grad():
        policy.log_std.copy_(spread.log())
    observation, command = random(count, 3), random(count, 2, seed=1)
    before, advantage, wanted = random(count, seed=2), random(count, seed=3), random(count, seed=4)
    before = policy.evaluate_actions(observation, command)[1].detach() + 0.3 * before  # some ratios are clipped
    buffer = model.rollout_buffer
    for tick in range(count):
        start = np.array([tick == 0])
        met, done = observation[None, tick].numpy(), command[None, tick].numpy()
        buffer.add(met, done, np.zeros(1), start, torch.zeros(1), before[None, tick])
    buffer.advantages[:, 0], buffer.returns[:, 0] = advantage, wanted
    model.train()
    theirs = {name: parameter.grad.clone() for name, parameter in policy.named_parameters() if name != "log_std"}

    mean = policy.get_distribution(observation).distribution.mean
    value = policy.predict_values(observation).squeeze(1)
    now = log_probability(mean, spread, command, torch.ones_like(command))
    found = losses(now, before, normalised(advantage), value, wanted, clip=CLIP)
    logged = model.logger.name_to_value
    assert found.policy.item() == pytest.approx(logged["train/policy_gradient_loss"], rel=1e-4)
    assert found.value.item() == pytest.approx(logged["train/value_loss"], rel=1e-4)
    assert found.kl.item() == pytest.approx(logged["train/approx_kl"], rel=1e-4)
    assert 0.1 < logged["train/clip_fraction"] < 0.9
    policy.zero_grad()
    (found.policy + found.value).backward()
    for name, gradient in theirs.items():
        torch.testing.assert_close(policy.get_parameter(name).grad, gradient, rtol=1e-4, atol=1e-6)


def test_only_commands_that_are_due_have_a_probability() -> None:
    mean, command, spread = random(4, 3), random(4, 3, seed=1), torch.tensor([0.1, 2.0, 0.5])
    due = torch.tensor([1.0, 0.0, 1.0])
    every = log_probability(mean, spread, command, torch.ones(3))
    first, middle, last = (log_probability(mean, spread, command, row) for row in torch.eye(3))
    torch.testing.assert_close(every, first + middle + last)
    torch.testing.assert_close(log_probability(mean, spread, command, due), first + last)


def test_the_critic_sees_and_says_numbers_of_the_order_of_one() -> None:
    critic = Critic(3, CriticConfig(), torch.Generator().manual_seed(0))
    observation = torch.tensor([1e4, -1e-3, 5.0]) * random(100, 3) + torch.tensor([1e5, 0.0, 5.0])
    observation[:, 2] = 7.0  # which never varies
    returns = 1e3 * random(100, seed=1) - 1e4
    critic.scale_to(observation, returns)
    assert critic.scaled(returns).std().item() == pytest.approx(1.0, abs=0.01)
    value = critic(observation)
    assert value.shape == (100,)
    assert critic.scaled(value).abs().max() < 5
    torch.testing.assert_close(critic(observation.reshape(10, 10, 3)).reshape(100), value)
