"""The task: how well paths are found again."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from neurorobo.bodies import Array, Body
from neurorobo.errors import NeuroroboError
from neurorobo.tasks.task import Flags, Task
from neurorobo_paradigms.path_memory.arena import Agent, Arena
from neurorobo_paradigms.path_memory.path_recall_config import PathRecallConfig
from neurorobo_paradigms.path_memory.polyline import Polyline


@dataclass
class _Recall:
    """One path that is walked alone, waypoint by waypoint."""

    path: Polyline
    reached: int = 0
    steps_until_lost: int = 0
    lost: bool = False
    off_m: list[float] = field(default_factory=list)

    @property
    def complete(self) -> bool:
        """Whether all waypoints behind the start were reached."""
        return self.reached == len(self.path.waypoints_m) - 1

    def walk(self, place_m: Array, config: PathRecallConfig) -> int:
        """Take note of where the agent has come to; return how many waypoints it has reached there."""
        if self.complete:
            return 0
        self.off_m.append(self.path.distance_m(place_m, self.reached + 1))
        self.lost |= self.off_m[-1] > config.lost
        self.steps_until_lost += not self.lost
        before = self.reached
        while not self.complete and np.hypot(*(place_m - self.path.waypoints_m[self.reached + 1])) <= config.tolerance:
            self.reached += 1
        return self.reached - before


@dataclass
class _Episode:
    """What has come of the runs so far, by their numbers."""

    recalls: dict[int, _Recall] = field(default_factory=dict)
    corrections_m: dict[int, list[float]] = field(default_factory=dict)
    reward: float = 0.0

    def observe(self, agent: Agent, config: PathRecallConfig) -> None:
        """Take note of a motion."""
        self.reward = 0.0
        if not agent.moved:
            return
        if agent.run.kind != "alone":
            self.corrections_m.setdefault(agent.number, []).append(float(np.hypot(*agent.correction_m)))
        else:
            recall = self.recalls.setdefault(agent.number, _Recall(agent.path))
            self.reward = float(recall.walk(agent.place_m, config))

    def metrics(self, agent: Agent) -> dict[str, float]:
        """Return the figures so far; of what has not been yet, the worst."""
        recalls, paths = self.recalls.values(), len(agent.paths)
        told = [float(np.mean(corrections)) for corrections in self.corrections_m.values()]
        shares = [recall.reached / (len(recall.path.waypoints_m) - 1) for recall in recalls]
        deviations = [float(np.mean(recall.off_m)) for recall in recalls]
        return {
            "waypoints_reached": sum(shares) / paths,
            "deviation_m": float(np.mean(deviations)) if deviations else agent.config.side,
            "steps_until_lost": sum(recall.steps_until_lost for recall in recalls) / paths,
            "first_correction_m": float(np.mean(told[:paths])) if told else 0.0,
            "last_correction_m": float(np.mean(told[-paths:])) if told else 0.0,
            "success": float(len(recalls) == paths and all(recall.complete for recall in recalls)),
        }


class PathRecall(Task[Arena]):
    """Reach all waypoints of all paths in their order, alone; the reward of a motion is 1 for each that it reaches.

    Figures are means over the paths, each walked alone once. ``waypoints_reached`` is the share of the waypoints behind
    the start that were reached in order. Until the last one is reached, ``deviation_m`` is the mean distance from the
    stretch that leads to the next one, and ``steps_until_lost`` counts the motions until that distance was too large.
    ``first_correction_m`` and ``last_correction_m`` are the mean distances of the goals from where they should have
    been, when each path was led or guided for the first and for the last time.
    """

    higher_is_better = frozenset({"success", "waypoints_reached", "steps_until_lost"})

    def __init__(self, config: PathRecallConfig, body: Body) -> None:
        """Watch over an arena; a NeuroroboError if it is none."""
        if not isinstance(body, Arena):
            raise NeuroroboError("tells how paths are found again in a `paradigms.arena`; take that as the body")
        super().__init__(config, body)
        self.config = config
        self.reset(0)

    def reset(self, batch: int, which: Flags | None = None) -> None:
        """Begin ``batch`` episodes, or begin again those that ``which`` marks."""
        if which is None:
            self._episodes = [_Episode() for _ in range(batch)]
            return
        for number in np.flatnonzero(which).tolist():
            self._episodes[number] = _Episode()

    def observe(self, duration_ns: int, running: Flags) -> None:
        """Take note of a motion; episodes that have ended keep their figures."""
        for number in np.flatnonzero(running).tolist():
            self._episodes[number].observe(self.body.agents[number], self.config)

    def reward(self) -> Array:
        """Return how many waypoints (batch) the last motion has reached."""
        return np.array([episode.reward for episode in self._episodes])

    def terminated(self) -> Flags:
        """Return which episodes (batch) have had their last run."""
        return np.array([agent.finished for agent in self.body.agents], dtype=np.bool_)

    def truncated(self) -> Flags:
        """No episode runs out of time: runs end by themselves."""
        return np.zeros(len(self._episodes), dtype=np.bool_)

    def metrics(self) -> Sequence[dict[str, float]]:
        """Return the figures of each episode."""
        return [episode.metrics(agent) for episode, agent in zip(self._episodes, self.body.agents, strict=True)]
