"""The body: sensors and actuators, simulated or real, that a brain reads and moves."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from neurorobo.bodies.latencies import Latencies
from neurorobo.errors import did_you_mean
from neurorobo.safety.guard import SensorGuard
from neurorobo.safety.limits import SensorLimits

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Sensor:
    """What a sensor reports: ``width`` components in ``unit`` within ``lo..hi``.

    It counts in steps of ``resolution``; 0 stands for a continuous one.
    """

    unit: str
    width: int = 1
    lo: float = -np.inf
    hi: float = np.inf
    resolution: float = 0.0
    description: str = ""


@dataclass(frozen=True)
class Actuator:
    """What an actuator takes: ``width`` components in ``unit`` within ``lo..hi``.

    A ``hold`` command stays in force until the next one (a speed); an ``increment`` is carried out once (a move).
    """

    unit: str
    width: int = 1
    lo: float = -np.inf
    hi: float = np.inf
    kind: Literal["hold", "increment"] = "hold"
    description: str = ""


class BodyConfig(BaseModel, ABC):
    """Base of every body's configuration: its sensors and actuators are known before anything is connected."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    implementation: ClassVar[str]

    type: str
    safety: Mapping[str, SensorLimits] = Field(
        default={},
        exclude_if=lambda limits: not limits,
        description="What sensors may report, by their names, before the body is stopped: {force: {stop: 9 N}}.",
    )

    @model_validator(mode="after")
    def _safety_is_of_sensors(self) -> Self:
        if self.safety:
            self.guards()
        return self

    def guards(self) -> list[SensorGuard]:
        """Return a guard of each sensor under ``safety``; a ValueError for one that is not there, or another unit."""
        sensors = self.sensors()
        guards = []
        for name, limits in self.safety.items():
            if name not in sensors:
                raise ValueError(f"safety: there is no sensor `{name}`{did_you_mean(name, sensors)}")
            try:
                guards.append(SensorGuard(name, sensors[name].unit, limits.in_unit(sensors[name].unit)))
            except ValueError as error:
                raise ValueError(f"safety.{name}: {error}") from None
        return guards

    @abstractmethod
    def sensors(self) -> dict[str, Sensor]:
        """Return the sensors by name."""

    @abstractmethod
    def actuators(self) -> dict[str, Actuator]:
        """Return the actuators by name."""


class Body(ABC):
    """A batch of equal bodies moving side by side; a real one is a batch of one.

    Every value is an array (batch, width). Randomness, if any, comes from one generator per body, seeded in
    :meth:`reset`, so that what happens to one body does not depend on the batch it moves in.
    """

    largest_batch: ClassVar[int | None] = None
    """How many can move side by side; 1 for a real one, of which there is no second."""

    def __init__(self, config: BodyConfig) -> None:
        """Prepare the body; nothing moves before :meth:`reset`."""
        self.sensors = config.sensors()
        self.actuators = config.actuators()
        self.guards = config.guards
        self.latencies = Latencies()

    def arm(self, *, dry_run: bool = False) -> None:  # noqa: B027 - a simulated body needs no leave to move
        """Allow a real body to move, or to show what it would be sent and not move; a simulated one needs no leave.

        A real body that was not armed refuses to be reset, by a :class:`NeuroroboError` that says so.
        """

    def timing(self) -> dict[str, Any]:
        """Return how quickly the body was answered, ready for JSON; a real one adds what became of its deadlines."""
        return self.latencies.figures()

    @abstractmethod
    def reset(self, seeds: Sequence[int], which: NDArray[np.bool_] | None = None) -> None:
        """Bring bodies to their start.

        Without ``which``, ``len(seeds)`` bodies make up the batch from now on. With it (batch), only the bodies it
        marks start again, one seed for each of them in order; the others go on undisturbed.
        """

    @abstractmethod
    def read(self) -> dict[str, Array]:
        """Return what every sensor reports now.

        Reading twice without a motion in between gives the same: noise is drawn in :meth:`reset` and :meth:`advance`.
        """

    @abstractmethod
    def advance(self, commands: Mapping[str, Array], duration_ns: int) -> None:
        """Carry out ``commands`` for ``duration_ns``.

        An actuator without a new command keeps its speed or stands still.
        """

    def limits(self, duration_ns: int) -> dict[str, tuple[Array, Array]]:
        """Return the least and largest command that each actuator may be given for the coming ``duration_ns``.

        By default what the actuators declare; a body narrows it by its present state (speed, distance left).
        """
        return {
            name: (np.full(actuator.width, actuator.lo), np.full(actuator.width, actuator.hi))
            for name, actuator in self.actuators.items()
        }

    @abstractmethod
    def stop(self) -> None:
        """Stop every motion; safe to call at any time, and called at the end of every batch, however it ended."""

    def standstill(self) -> str:
        """Say, for who has interrupted a real body, how it was stopped the last time; of a simulated one nothing."""
        return ""

    def close(self) -> None:  # noqa: B027 - a simulated body holds nothing
        """Let go of what a real body holds, such as ports; called at the end of every run, and safe to call twice."""
