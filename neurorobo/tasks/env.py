"""Tasks as Gymnasium environments: one class for a batch, and the single environment as its view of width one."""

from collections.abc import Callable, Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Dict
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from neurorobo.bodies import Actuator, Body, Sensor
from neurorobo.tasks.supervised import SupervisedTask
from neurorobo.tasks.task import Task

Observation = dict[str, NDArray[np.float32]]
Factory = Callable[[], Task[Body]]


class TaskVectorEnv(VectorEnv[Observation, Observation, NDArray[Any]]):
    """A batch of episodes that move together; finished ones start again in the same step.

    Observations and actions are dictionaries of sensors and actuators, in their own units (float32). Every step lasts
    ``period_ns``. Of episodes that just ended, ``info`` carries the last observation (``final_obs``), and the task's
    metrics and the number of command interventions (``final_info``), in Gymnasium's own form.
    """

    metadata = {"autoreset_mode": AutoresetMode.SAME_STEP}  # noqa: RUF012 (Gymnasium's own attribute)

    def __init__(self, task: Factory, num_envs: int = 1, *, period_ns: int) -> None:
        """Make ``num_envs`` bodies with the given task."""
        self.task = task()
        self.body = self.task.body
        self._supervised = SupervisedTask(self.task)
        self.num_envs = num_envs
        self.period_ns = period_ns
        self.single_observation_space = _space(self.body.sensors)
        self.single_action_space = _space(self.body.actuators)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._seeds = [np.random.default_rng() for _ in range(num_envs)]

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start every episode; ``seed`` + i, or the i-th of a sequence, seeds the i-th one."""
        seeds = (
            [None if seed is None else seed + i for i in range(self.num_envs)]
            if not isinstance(seed, Sequence)
            else seed
        )
        episode_seeds = []
        for i, chosen in enumerate(seeds):
            if chosen is not None:
                self._seeds[i] = np.random.default_rng(chosen)
            episode_seeds.append(int(self._seeds[i].integers(2**31)) if chosen is None else int(chosen))
        self._supervised.reset(episode_seeds, self.num_envs)
        return self._observation(), {}

    def step(
        self, actions: Observation
    ) -> tuple[Observation, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Carry out one action per episode."""
        running = np.ones(self.num_envs, dtype=np.bool_)
        commands = {name: np.asarray(value, dtype=np.float64) for name, value in actions.items()}
        _, done = self._supervised.step(commands, self.period_ns, running)
        # Copies, as the new start below may write into what the task returned.
        reward = self.task.reward().copy()
        terminated, truncated = self.task.terminated().copy(), self.task.truncated().copy()
        info: dict[str, Any] = {}
        if done.any():
            last, metrics = self._observation(), self._supervised.metrics()
            ended: list[int] = np.flatnonzero(done).tolist()
            for i in ended:
                final = {"final_obs": {name: values[i] for name, values in last.items()}, "final_info": metrics[i]}
                info = self._add_info(info, final, i)
            self._supervised.reset([int(self._seeds[i].integers(2**31)) for i in ended], self.num_envs, done)
        return self._observation(), reward, terminated, truncated, info

    def close_extras(self, **kwargs: Any) -> None:
        """Stop the body and close it; a real one may first go back to where it began."""
        try:
            self.body.stop()
        finally:
            self.body.close()

    def _observation(self) -> Observation:
        return {
            name: np.clip(values, self.body.sensors[name].lo, self.body.sensors[name].hi).astype(np.float32)
            for name, values in self.body.read().items()
        }


class TaskEnv(gymnasium.Env[Observation, Observation]):
    """One episode at a time: a view of :class:`TaskVectorEnv` of width one."""

    def __init__(self, task: Factory, *, period_ns: int) -> None:
        """Make one body with the given task."""
        self._batch = TaskVectorEnv(task, 1, period_ns=period_ns)
        self.observation_space = self._batch.single_observation_space
        self.action_space = self._batch.single_action_space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode."""
        super().reset(seed=seed)
        if seed is None:
            seed = int(self.np_random.integers(2**31))
        observation, _ = self._batch.reset(seed=seed)
        return _first(observation), {}

    def step(self, action: Observation) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Carry out one action."""
        batched = {name: np.asarray(value)[None] for name, value in action.items()}
        observation, reward, terminated, truncated, info = self._batch.step(batched)
        if terminated[0] or truncated[0]:
            figures = info["final_info"].items()  # arrays of one, each with a mask under `_` and its name
            observation_now, info = info["final_obs"][0], {k: float(v[0]) for k, v in figures if not k.startswith("_")}
        else:
            observation_now, info = _first(observation), {}
        return observation_now, float(reward[0]), bool(terminated[0]), bool(truncated[0]), info

    def close(self) -> None:
        """Stop the body and close it; a real one may first go back to where it began."""
        self._batch.close()


def _space(channels: dict[str, Sensor] | dict[str, Actuator]) -> Dict:
    return Dict(
        {
            name: Box(np.float32(channel.lo), np.float32(channel.hi), (channel.width,), np.float32)
            for name, channel in channels.items()
        }
    )


def _first(observation: Observation) -> Observation:
    return {name: values[0] for name, values in observation.items()}
