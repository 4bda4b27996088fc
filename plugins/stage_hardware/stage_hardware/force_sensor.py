"""What a force sensor is to the rest: components that are known before connecting, and readings that know their age."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Self


@dataclass(frozen=True)
class Component:
    """One component of a wrench, within ``-largest..largest`` in ``unit`` (mN or mN*m), in steps of ``resolution``."""

    unit: str
    largest: float
    resolution: float


@dataclass(frozen=True)
class ForceReading:
    """A wrench at ``time_ns`` of the monotonic clock, component by component.

    ``values`` are counted from the last bias, ``unbiased`` from the device's own zero: a bias that was taken in contact
    hides a load, and limits that must hold look at these. ``sequence`` grows from reading to reading; ``lost`` counts
    those that never came. A reading that is not ``valid`` says why in ``fault``.
    """

    time_ns: int
    sequence: int
    values: Mapping[str, float]
    unbiased: Mapping[str, float]
    lost: int = 0
    fault: str | None = None

    @property
    def valid(self) -> bool:
        """Whether it can be used."""
        return self.fault is None

    def age_ns(self, now_ns: int) -> int:
        """Return how long ago it was."""
        return now_ns - self.time_ns


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
    def latest(self) -> ForceReading:
        """Return the last reading; its age tells whether the sensor has fallen silent."""

    def __enter__(self) -> Self:
        """Start."""
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Stop."""
        self.stop()
