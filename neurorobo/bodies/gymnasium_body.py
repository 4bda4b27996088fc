"""A Gymnasium environment as a body."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from neurorobo.bodies.body import Array, Body
from neurorobo.bodies.gymnasium_body_config import GymnasiumBodyConfig
from neurorobo.bodies.gymnasium_spaces import make, to_action, to_vector
from neurorobo.errors import NeuroroboError
from neurorobo.units import format_duration

if TYPE_CHECKING:
    from gymnasium import Env


class GymnasiumBody(Body):
    """A batch of environments of one kind, each seeded for its own episode; one that has ended stands still.

    ``reward``, ``terminated`` and ``truncated`` (batch) are what the environments said after the last motion. What is
    not commanded is as near to zero as the action's bounds allow.
    """

    reward: Array
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]

    def __init__(self, config: GymnasiumBodyConfig) -> None:
        super().__init__(config)
        spaces = config.spaces
        self._config = config
        self._period_ns = spaces.period_ns
        self._bounds = spaces.action
        self._still = np.clip(0.0, *spaces.action)
        self._seen = {name: sensor.indices(spaces.observation) for name, sensor in config.senses.items()}
        self._moved = {name: actuator.indices(spaces.action) for name, actuator in config.moves.items()}
        self._width = len(spaces.observation[0])
        self._environments: list[Env[Any, Any]] = []
        self.reset([])

    def reset(self, seeds: Sequence[int], which: NDArray[np.bool_] | None = None) -> None:
        """Start an episode for each seed."""
        if which is None:
            batch = len(seeds)
            which = np.ones(batch, dtype=np.bool_)
            for _ in range(batch - len(self._environments)):
                self._environments.append(make(self._config.environment, self._config.kwargs))
            self._observation = np.zeros((batch, self._width))
            self._action = np.tile(self._still, (batch, 1))
            self.reward = np.zeros(batch)
            self.terminated, self.truncated = np.zeros((2, batch), dtype=np.bool_)
        for i, seed in zip(np.flatnonzero(which), seeds, strict=True):
            environment = self._environments[i]
            observation, _ = environment.reset(seed=int(seed))
            self._observation[i] = to_vector(environment, observation)
        self._action[which] = self._still
        self.reward[which] = 0.0
        self.terminated[which] = self.truncated[which] = False

    def read(self) -> dict[str, Array]:
        """Return what was last observed, within the sensors' ranges."""
        return {
            name: np.clip(self._observation[:, indices], self.sensors[name].lo, self.sensors[name].hi)
            for name, indices in self._seen.items()
        }

    def advance(self, commands: Mapping[str, Array], duration_ns: int) -> None:
        """Take one step; a NeuroroboError if the environment's steps have another length."""
        if self._period_ns is not None and duration_ns != self._period_ns:
            period = format_duration(self._period_ns)
            raise NeuroroboError(
                f"a step of `{self._config.environment}` takes {period}, not {format_duration(duration_ns)}; "
                f"write `time: {{control: {period}, ...}}`, and let no other period be shorter"
            )
        for name, values in commands.items():
            self._action[:, self._moved[name]] = values
        self.reward[:] = 0.0
        for i in np.flatnonzero(~(self.terminated | self.truncated)):
            environment = self._environments[i]
            observation, reward, terminated, truncated, _ = environment.step(to_action(environment, self._action[i]))
            self._observation[i] = to_vector(environment, observation)
            self.reward[i], self.terminated[i], self.truncated[i] = float(reward), terminated, truncated

    def limits(self, duration_ns: int) -> dict[str, tuple[Array, Array]]:
        """Return the bounds of each element of the action."""
        lo, hi = self._bounds
        return {name: (lo[indices], hi[indices]) for name, indices in self._moved.items()}

    def stop(self) -> None:
        """Do nothing: an environment moves in its steps only."""
