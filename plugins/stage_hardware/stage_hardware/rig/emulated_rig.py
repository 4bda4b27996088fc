"""A whole rig of emulators, whose force sensor feels where their axes are."""

from collections.abc import Sequence
from contextlib import ExitStack
from types import MappingProxyType
from typing import Any, Self

from neurorobo.errors import NeuroroboError
from neurorobo.plugins.imports import described, import_target
from stage_hardware.rig.physics import Physics
from stage_hardware.rig.rig_config import FORCE_SENSOR, RigConfig

NOTHING = (0.0,) * 6


class EmulatedRig:
    """The devices of a rig as emulators, from ``with`` to its end.

    ``controllers`` and ``sensor`` are the emulated devices, whose ``emulator`` has fault switches; ``box`` is that of
    the sensor. ``config`` is the rig at their addresses, ``physics`` what the sensor feels. ``fault`` is what is wrong
    with the physics, if it failed: the sensor feels what it felt last from then on.
    """

    def __init__(self, config: RigConfig) -> None:
        """Prepare it; a NeuroroboError for a device that has no emulator, and for physics that cannot be built."""
        self._rig, self._frames = config, config.frames
        self.physics = _physics(config)
        self.controllers = MappingProxyType(
            {name: controller.emulate(name) for name, controller in config.controllers.items()}
        )
        self.sensor = config.force_sensor.emulate(FORCE_SENSOR, self._wrench)
        self.fault: str | None = None
        self._felt: Sequence[float] = NOTHING
        self._running = ExitStack()

    @property
    def config(self) -> RigConfig:
        """The rig with addresses replaced by those of the emulators, once they run."""
        return self._rig.model_copy(
            update={
                "controllers": {name: controller.config for name, controller in self.controllers.items()},
                "force_sensor": self.sensor.config,
            }
        )

    @property
    def box(self) -> Any:
        """The emulator of the force sensor."""
        return self.sensor.emulator

    def positions(self) -> dict[str, float]:
        """Return where the axes are, in um from where episodes begin, whatever their controllers believe."""
        return {
            name: self._frames[name].to_rig(position)
            for controller in self.controllers.values()
            for name, position in controller.positions().items()
        }

    def _wrench(self, time_s: float) -> Sequence[float]:
        if self.physics is not None and self.fault is None:
            try:
                self._felt = self.physics.wrench(self.positions())
            except Exception as error:  # in a thread of the sensor, whose end would pass for a silent device
                self.fault = f"its physics has failed: {described(error)}"
        return self._felt

    def __enter__(self) -> Self:
        """Start all emulators, or none."""
        with ExitStack() as running:
            for device in (*self.controllers.values(), self.sensor):
                running.enter_context(device)
            self._running = running.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        """End them."""
        self._running.close()


def _physics(config: RigConfig) -> Physics | None:
    """Return what the sensor feels, if the rig file says so."""
    if config.emulate is None:
        return None
    physics = config.emulate.physics
    try:
        built: Physics = import_target(physics.implementation)(physics)
    except ValueError as error:
        raise NeuroroboError(f"emulate.physics: {physics.type} cannot be built: {error}") from error
    return built
