"""The task: what a body is to achieve, when an episode ends, and how well it went."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from neurorobo.bodies import Array, Body

BodyType = TypeVar("BodyType", bound=Body)
Flags = NDArray[np.bool_]


class TaskConfig(BaseModel):
    """Base of every task's configuration."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    implementation: ClassVar[str]

    type: str


class Task(ABC, Generic[BodyType]):
    """A goal for a batch of bodies.

    ``higher_is_better`` names the metrics of which the smallest value is the worst; of all others it is the largest.
    ``scene``, as ``"package.module:Class"``, is what draws the body in recordings
    (:class:`neurorobo.views.recording.Scene`).
    """

    higher_is_better: frozenset[str] = frozenset({"success"})
    scene: ClassVar[str | None] = None

    def __init__(self, config: TaskConfig, body: BodyType) -> None:
        """Give ``body`` a task; raise :class:`NeuroroboError` if it is not a body for it."""
        self.body = body

    @abstractmethod
    def reset(self, batch: int, which: Flags | None = None) -> None:
        """Begin ``batch`` episodes, the bodies being at their start; with ``which`` (batch), begin again only those."""

    @abstractmethod
    def observe(self, duration_ns: int, running: Flags) -> None:
        """Take note of a motion of ``duration_ns`` that has just ended, in the ``running`` (batch) episodes."""

    @abstractmethod
    def reward(self) -> Array:
        """Return the reward (batch) of the last motion."""

    @abstractmethod
    def terminated(self) -> Flags:
        """Return which episodes (batch) have reached an end of their own: the goal, or a failure."""

    @abstractmethod
    def truncated(self) -> Flags:
        """Return which episodes (batch) have run out of time."""

    @abstractmethod
    def metrics(self) -> Sequence[dict[str, float]]:
        """Return for each episode of the batch its figures so far; ``success`` is 1 or 0, units are in the names."""
