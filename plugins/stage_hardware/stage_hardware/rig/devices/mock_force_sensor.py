"""The configuration of a force sensor without a wire, for rigs without devices."""

from contextlib import nullcontext
from typing import TYPE_CHECKING, Literal

from pydantic import Field, PrivateAttr

from stage_hardware.emulators.wrench import Wrench, at_rest
from stage_hardware.rig.device_config import ForceSensorConfig
from stage_hardware.rig.devices.wrench_sensor import WrenchSensorConfig
from stage_hardware.rig.emulated_device import EmulatedDevice

if TYPE_CHECKING:
    from stage_hardware.emulators.mock_force_sensor import MockForceSensor


class MockForceSensorConfig(WrenchSensorConfig):
    """A sensor in this process, which no other program can reach; it feels nothing unless it is emulated."""

    type: Literal["stages.mock_force_sensor"]
    bias_readings: int = Field(default=100, ge=1, strict=True, description="How many readings a bias is the mean of.")

    _emulated: "MockForceSensor | None" = PrivateAttr(default=None)

    @property
    def address(self) -> str:
        """It has none."""
        return ""

    def build(self, name: str) -> "MockForceSensor":
        """Return a sensor: the emulated one, if this is its configuration."""
        return self._emulated or self._sensor(name, at_rest)

    def emulate(self, name: str, wrench: Wrench) -> EmulatedDevice[ForceSensorConfig]:
        """Return a sensor that is its own emulator."""
        sensor, config = self._sensor(name, self._counted(wrench)), self.model_copy()
        config._emulated = sensor
        return EmulatedDevice(sensor, lambda: config, nullcontext())

    def _sensor(self, name: str, wrench: Wrench) -> "MockForceSensor":
        from stage_hardware.emulators.mock_force_sensor import MockForceSensor

        return MockForceSensor(name, self.components, wrench, rate_Hz=self.rate, bias_readings=self.bias_readings)
