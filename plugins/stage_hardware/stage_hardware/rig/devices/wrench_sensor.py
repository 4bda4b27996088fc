"""What the configurations of sensors of a whole wrench have in common."""

from abc import ABC
from typing import Annotated

from pydantic import Field

from neurorobo.units import Unit
from stage_hardware.emulators.wrench import Wrench
from stage_hardware.force_sensor import Component, wrench_components
from stage_hardware.rig.device_config import ForceSensorConfig

Force = Annotated[float, Unit("mN", gt=0)]
Torque = Annotated[float, Unit("mN*m", gt=0)]


class WrenchSensorConfig(ForceSensorConfig, ABC):
    """A sensor of three forces and three torques."""

    largest_force: tuple[Force, Force, Force] = Field(description="Its range about x, y and z: [18 N, 18 N, 18 N].")
    largest_torque: tuple[Torque, Torque, Torque] = Field(description="Its range about x, y and z.")
    force_resolution: Force = Field(description="The least force that it tells.")
    torque_resolution: Torque = Field(description="The least torque that it tells.")
    rate: Annotated[float, Unit("Hz", gt=0)] = Field(default=1000.0, description="Readings per second.")

    @property
    def components(self) -> dict[str, Component]:
        """What it reads, component by component."""
        return wrench_components(
            self.largest_force,
            self.largest_torque,
            resolution_mN=self.force_resolution,
            resolution_mNm=self.torque_resolution,
        )

    def _counted(self, wrench: Wrench) -> Wrench:
        """Return a load in the steps that the sensor tells."""
        steps = [component.resolution for component in self.components.values()]
        return lambda time_s: [round(value / step) * step for value, step in zip(wrench(time_s), steps, strict=True)]
