"""The arena: an agent is led along paths, guided along them, and then walks alone."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from neurorobo.bodies import Array, Body
from neurorobo_paradigms.path_memory.arena_config import ArenaConfig, DrawnPaths
from neurorobo_paradigms.path_memory.polyline import Polyline, draw_path

DISTURBANCE_S = 0.5
"""For how long a disturbance lasts: the time constant of its correlation."""

FASTEST = 1.5
"""How fast an agent can walk, in multiples of the speed at which it is led."""


@dataclass(frozen=True)
class Run:
    """One way along a path, by its number."""

    path: int
    kind: Literal["led", "guided", "alone"]


class Agent:
    """One agent of a batch: its paths, its runs and where it is; drawn and disturbed by a generator of its own."""

    def __init__(self, config: ArenaConfig, seed: int) -> None:
        self.config = config
        self.generator = np.random.default_rng(seed)
        if isinstance(config.paths, DrawnPaths):
            self.paths = [draw_path(config.paths, config.side, self.generator) for _ in range(config.paths.number)]
        else:
            self.paths = [Polyline.through(config.side * np.array(path)) for path in config.paths]
        numbers = range(len(self.paths))
        self.runs = [Run(path, "led") for _ in range(config.led_runs) for path in numbers]
        self.runs += [Run(path, "guided") for _ in range(config.guided_runs) for path in numbers]
        self.runs += [Run(path, "alone") for path in numbers]
        self.goal_m = np.full(2, config.side / 2)
        self.correction_m, self.moved = np.zeros(2), False
        self._begin(0)
        self._sense()

    @property
    def run(self) -> Run:
        """The present run; at the end of all, the last one."""
        return self.runs[self.number]

    @property
    def path(self) -> Polyline:
        """The path of the present run."""
        return self.paths[self.run.path]

    @property
    def over(self) -> bool:
        """Whether the present run has ended; the next one begins with the next motion."""
        times = self.config.recall_time if self.run.kind == "alone" else 1.0
        lasts_s = times * self.path.length_m / self.config.speed
        return (self.elapsed_ns - self.config.cue) * 1e-9 >= lasts_s - 1e-9

    @property
    def finished(self) -> bool:
        """Whether the last run has ended."""
        return self.over and self.number == len(self.runs) - 1

    def advance(self, duration_ns: int) -> None:
        """Be held, or move."""
        self.correction_m, self.moved = np.zeros(2), False
        if self.finished:
            return
        if self.over:
            self._begin(self.number + 1)
        if self.elapsed_ns >= self.config.cue:
            self._move((self.elapsed_ns - self.config.cue) * 1e-9, duration_ns * 1e-9)
        self.elapsed_ns += duration_ns
        self._sense()

    def _begin(self, number: int) -> None:
        """Be put at the start of a run."""
        self.number, self.elapsed_ns, self.disturbance_m_s = number, 0, np.zeros(2)
        self.place_m = self.path.at(0.0)
        if self.run.kind == "alone" and self.config.start_offset:
            angle = self.generator.uniform(-np.pi, np.pi)
            aside_m = self.config.start_offset * np.array([np.cos(angle), np.sin(angle)])
            self.place_m = np.clip(self.place_m + aside_m, 0.0, self.config.side)

    def _move(self, shown_s: float, duration_s: float) -> None:
        """Move for ``duration_s``, so long after the cue."""
        config, self.moved = self.config, True
        lasts = np.exp(-duration_s / DISTURBANCE_S)
        pushed = config.recall_disturbance if self.run.kind == "alone" else config.disturbance
        drawn = pushed * self.generator.normal(size=2)
        self.disturbance_m_s = lasts * self.disturbance_m_s + np.sqrt(1 - lasts**2) * drawn
        velocity_m_s = (self.goal_m - self.place_m) / (config.horizon * 1e-9)
        velocity_m_s *= min(1.0, FASTEST * config.speed / max(float(np.hypot(*velocity_m_s)), 1e-9))
        if self.run.kind != "alone":
            here_m, next_m = (self.path.at(config.speed * t) for t in (shown_s, shown_s + duration_s))
            self.correction_m = self.path.at(config.speed * (shown_s + config.horizon * 1e-9)) - self.goal_m
            if self.run.kind == "led":
                velocity_m_s = (next_m - here_m) / duration_s
            velocity_m_s = velocity_m_s + config.leash * (here_m - self.place_m)
        moved_m = self.place_m + duration_s * (velocity_m_s + self.disturbance_m_s)
        self.place_m = np.clip(moved_m, 0.0, config.side)

    def _sense(self) -> None:
        error_m = self.config.sensor_noise * self.generator.normal(size=2)
        self.sensed_m = np.clip(self.place_m + error_m, 0.0, self.config.side)


class Arena(Body):
    """A batch of agents, each in an arena of its own; places are in m, each an array (batch, 2).

    Alone, an agent walks towards its goal, ``v = (goal - place) / horizon``, at up to 1.5 times the speed at which it
    is led. A leash adds ``leash * (p - place)``, where the point p moves along the path at that speed. Led, it has the
    velocity of p in place of its own. Led or guided, it is told by how much its goal differs from where p will be
    after the horizon. A disturbance adds to the velocity: an Ornstein-Uhlenbeck process with a time constant of 0.5 s.
    """

    def __init__(self, config: ArenaConfig) -> None:
        """Prepare the arenas; :meth:`reset` says how many there are."""
        super().__init__(config)
        self.config = config
        self.agents: list[Agent] = []

    def reset(self, seeds: Sequence[int], which: NDArray[np.bool_] | None = None) -> None:
        """Bring agents to the start of their first run; what is drawn comes from the seed of each."""
        if which is None:
            self.agents = [Agent(self.config, seed) for seed in seeds]
            return
        for number, seed in zip(np.flatnonzero(which).tolist(), seeds, strict=True):
            self.agents[number] = Agent(self.config, seed)

    def read(self) -> dict[str, Array]:
        """Return what is sensed."""
        alone = [float(agent.moved and agent.run.kind == "alone") for agent in self.agents]
        return {
            "place": np.array([agent.sensed_m for agent in self.agents]).reshape(-1, 2),
            "correction": np.array([agent.correction_m for agent in self.agents]).reshape(-1, 2),
            "alone": np.array(alone).reshape(-1, 1),
        }

    def advance(self, commands: Mapping[str, Array], duration_ns: int) -> None:
        """Move on, each agent towards its goal or as it is led."""
        for number, agent in enumerate(self.agents):
            if "goal" in commands:
                agent.goal_m = commands["goal"][number].copy()
            agent.advance(duration_ns)

    def stop(self) -> None:
        """Stand still: each agent's goal is where it is."""
        for agent in self.agents:
            agent.goal_m = agent.place_m.copy()
