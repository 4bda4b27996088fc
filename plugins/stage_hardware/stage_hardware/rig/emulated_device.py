"""Emulated devices of a rig: what runs in place of a device, where it is found, and where its axes are."""

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Generic, Self, TypeVar

from stage_hardware.emulators.mechanism import Mechanism

Config = TypeVar("Config", covariant=True)


class EmulatedDevice(Generic[Config]):
    """A device that is emulated from ``with`` to its end.

    ``emulator`` is what answers, with its fault switches. ``config`` is the configuration of the device at the address
    of the emulator, once that runs.
    """

    def __init__(
        self, emulator: Any, config: Callable[[], Config], running: AbstractContextManager[object] | None = None
    ) -> None:
        """Take an emulator and what makes its configuration; ``running`` starts and ends it, by default it itself."""
        self.emulator, self._config = emulator, config
        self._running: AbstractContextManager[object] = emulator if running is None else running

    @property
    def config(self) -> Config:
        """The configuration that reaches it."""
        return self._config()

    def __enter__(self) -> Self:
        """Start."""
        self._running.__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        """End."""
        self._running.__exit__(*error)


@dataclass(frozen=True)
class EmulatedAxis:
    """An axis whose mechanism counts ``um_per_count``, and whose physical zero is at ``origin`` of its coordinates."""

    mechanism: Mechanism
    um_per_count: float = 1.0
    origin: float = 0.0

    @property
    def position(self) -> float:
        """Where it is, in um, whatever its controller believes."""
        return self.origin + self.um_per_count * self.mechanism.position


class EmulatedStage(EmulatedDevice[Config]):
    """An emulated controller and its axes, by name."""

    def __init__(
        self,
        emulator: Any,
        config: Callable[[], Config],
        axes: Mapping[str, EmulatedAxis],
        running: AbstractContextManager[object] | None = None,
    ) -> None:
        """Take an emulator, what makes its configuration, and its axes."""
        super().__init__(emulator, config, running)
        self.axes = MappingProxyType(dict(axes))

    def positions(self) -> dict[str, float]:
        """Return where the axes are, in um of their own coordinates: 0 at the origin."""
        return {name: axis.position for name, axis in self.axes.items()}
