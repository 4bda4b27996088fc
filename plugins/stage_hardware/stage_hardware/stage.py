"""What a stage is to the rest: axes known before connecting, absolute targets, and states that know their age."""

import math
from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Self

from stage_hardware.errors import HardwareError


@dataclass(frozen=True)
class Axis:
    """What an axis can do: positions within ``lo..hi`` in ``unit``, in steps of ``resolution``.

    ``speed`` and ``acceleration`` are the largest, in units per second and per second squared. Limits that are not set
    are refused, as are empty ones: for some controllers 0..0 stands for no limit at all.
    """

    unit: str
    lo: float
    hi: float
    resolution: float
    speed: float
    acceleration: float

    def __post_init__(self) -> None:
        """Refuse limits that are none."""
        if not -math.inf < self.lo < self.hi < math.inf:
            raise ValueError(f"an axis has travel limits, the lower one first, got {self.lo}..{self.hi} {self.unit}")
        for name in ("resolution", "speed", "acceleration"):
            if not 0 < getattr(self, name) < math.inf:
                raise ValueError(f"the {name} of an axis is positive and finite, got {getattr(self, name)}")

    def moves_for_s(self, distance: float) -> float:
        """Return how long a move takes that speeds up and slows down as it can, from rest to rest."""
        way, ramp = abs(distance), self.speed**2 / self.acceleration
        return (
            way / self.speed + self.speed / self.acceleration if way > ramp else 2 * math.sqrt(way / self.acceleration)
        )


@dataclass(frozen=True)
class AxisState:
    """Where an axis is, in its unit, and how it stands.

    ``referenced`` says whether its position counts from its origin: not before it was homed, nor after a power cycle.
    """

    position: float
    moving: bool
    referenced: bool
    at_lower_limit: bool = False
    at_upper_limit: bool = False


@dataclass(frozen=True)
class StageState:
    """The axes of a stage as they were at ``time_ns`` of the monotonic clock, and its fault, if it has one."""

    time_ns: int
    axes: Mapping[str, AxisState]
    fault: str | None = None

    def age_ns(self, now_ns: int) -> int:
        """Return how long ago it was."""
        return now_ns - self.time_ns


class Stage(ABC):
    """One controller and its axes.

    Commands are absolute and so can be repeated. :meth:`move_to` and :meth:`home` return at once; :meth:`state` tells
    when a motion is over. :meth:`stop` may be called from any thread at any time and waits for no other transaction.
    All methods raise a :class:`stage_hardware.errors.HardwareError`.
    """

    name: str
    axes: Mapping[str, Axis]
    begins_while_moving: bool = True
    """Whether an axis can be sent somewhere while another one is under way."""

    def __init__(self, name: str, axes: Mapping[str, Axis]) -> None:
        """Remember what is known before connecting."""
        self.name, self.axes = name, MappingProxyType(dict(axes))

    @abstractmethod
    def connect(self) -> None:
        """Open the link, see that the controller is the one that was meant, and set it up; nothing moves."""

    @abstractmethod
    def close(self) -> None:
        """Close the link; safe to call at any time, and twice."""

    @abstractmethod
    def home(self, axes: Collection[str]) -> None:
        """Begin to look for the origins of some axes; they are referenced when they move no more."""

    @abstractmethod
    def move_to(self, targets: Mapping[str, float]) -> None:
        """Begin to move some axes to absolute positions, in their units.

        Raises a HardwareError for a target beyond the limits, for an axis that is not referenced, and if the controller
        refuses.
        """

    @abstractmethod
    def stop(self) -> None:
        """Stop all axes as fast as the controller can; whether they have stopped, :meth:`state` tells."""

    @abstractmethod
    def state(self) -> StageState:
        """Ask the controller how all axes are."""

    def _refuse_unknown(self, axes: Collection[str]) -> None:
        """Raise a HardwareError for an axis that is not there."""
        for axis in axes:
            if axis not in self.axes:
                raise HardwareError(self.name, f"there is no axis {axis!r}", f"it has {', '.join(self.axes)}")

    def _refuse_targets(self, targets: Mapping[str, float], referenced: Collection[str]) -> None:
        """Raise a HardwareError for a target that is beyond the limits, or of an axis that is not referenced."""
        self._refuse_unknown(targets)
        for name, target in targets.items():
            axis = self.axes[name]
            if not axis.lo <= target <= axis.hi:
                raise HardwareError(
                    self.name,
                    f"axis {name} would go to {target:g} {axis.unit}",
                    f"stay within {axis.lo:g}..{axis.hi:g} {axis.unit}",
                )
            if name not in referenced:
                raise HardwareError(self.name, f"axis {name} does not know where it is", "home it first")

    def __enter__(self) -> Self:
        """Connect."""
        self.connect()
        return self

    def __exit__(self, *_: object) -> None:
        """Stop, and close whatever became of that."""
        try:
            self.stop()
        finally:
            self.close()
