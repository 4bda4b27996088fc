"""What a force sensor is to the rest: components that are known before connecting, and readings that know their age."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple, Self


@dataclass(frozen=True)
class Component:
    """One component of a wrench, within ``-largest..largest`` in ``unit`` (mN or mN*m), in steps of ``resolution``."""

    unit: str
    largest: float
    resolution: float


WRENCH = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")
"""The components of a whole wrench, in their usual order: forces in mN, torques in mN*m."""


def wrench_components(
    largest_mN: tuple[float, float, float],
    largest_mNm: tuple[float, float, float],
    *,
    resolution_mN: float,
    resolution_mNm: float,
) -> dict[str, Component]:
    """Return the components of a sensor of a whole wrench from its ranges, each about x, y and z."""
    forces = [Component("mN", largest, resolution_mN) for largest in largest_mN]
    torques = [Component("mN*m", largest, resolution_mNm) for largest in largest_mNm]
    return dict(zip(WRENCH, forces + torques, strict=True))


@dataclass(frozen=True)
class ForceReading:
    """A wrench at ``time_ns`` of the monotonic clock, component by component.

    ``values`` are counted from the last bias, ``unbiased`` from the device's own zero: a bias that was taken in contact
    hides a load, and limits that must hold look at these. ``sequence`` grows from reading to reading; ``lost`` counts
    those that did not come, or too late. A reading that is not ``valid`` says why in ``fault``; ``warning`` is what the
    device has to say without being wrong.
    """

    time_ns: int
    sequence: int
    values: Mapping[str, float]
    unbiased: Mapping[str, float]
    lost: int = 0
    fault: str | None = None
    warning: str | None = None

    @property
    def valid(self) -> bool:
        """Whether it can be used."""
        return self.fault is None

    def age_ns(self, now_ns: int) -> int:
        """Return how long ago it was."""
        return now_ns - self.time_ns


Watcher = Callable[[ForceReading], None]
"""What is called with each reading; a sensor whose watcher raises an exception gives no valid readings any more."""


class Sample(NamedTuple):
    """What came from a device at ``time_ns`` of the monotonic clock: components in their order, from its own zero."""

    time_ns: int
    sequence: int
    values: tuple[float, ...]
    lost: int = 0
    fault: str | None = None
    warning: str | None = None


class ForceSensor(ABC):
    """A sensor that is read in a thread of its own, at its own rate.

    :meth:`latest` never waits. All other methods raise a :class:`stage_hardware.errors.HardwareError`.
    """

    name: str
    components: Mapping[str, Component]
    rate_Hz: float

    def __init__(self, name: str, components: Mapping[str, Component], rate_Hz: float) -> None:
        """Remember what is known before connecting."""
        self.name, self.components, self.rate_Hz = name, MappingProxyType(dict(components)), rate_Hz

    @abstractmethod
    def start(self) -> None:
        """Connect and begin to read; returns when there is a first reading."""

    @abstractmethod
    def stop(self) -> None:
        """End the reading; safe to call at any time, and twice."""

    @abstractmethod
    def bias(self) -> None:
        """Count from the present load, on the host: the device's own stream stays as it is."""

    @abstractmethod
    def watch(self, watcher: Watcher) -> None:
        """Hand each reading to a watcher from now on, faulty ones too, in the thread that reads: it has to be quick.

        Silence is no reading: who watches for a limit looks at the age of :meth:`latest` as well.
        """

    @abstractmethod
    def latest(self) -> ForceReading:
        """Return the last reading; its age tells whether the sensor has fallen silent."""

    def __enter__(self) -> Self:
        """Start."""
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Stop."""
        self.stop()
