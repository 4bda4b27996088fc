"""The body: sensors and actuators, simulated or real, that a brain reads and moves."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

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

    def __init__(self, config: BodyConfig) -> None:
        """Prepare the body; nothing moves before :meth:`reset`."""
        self.sensors = config.sensors()
        self.actuators = config.actuators()

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
        """Stop every motion; safe to call at any time, and called at the end of every run, however it ended."""
