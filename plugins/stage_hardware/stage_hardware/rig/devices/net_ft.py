"""The configurations of ATI's Net F/T box: with the driver of the plugin, and through the library pynetft."""

from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field

from stage_hardware.emulators.wrench import Wrench
from stage_hardware.links import rdt
from stage_hardware.rig.device_config import ForceSensorConfig
from stage_hardware.rig.devices.wrench_sensor import WrenchSensorConfig
from stage_hardware.rig.emulated_device import EmulatedDevice

if TYPE_CHECKING:
    from stage_hardware.drivers.ati_net_ft import AtiNetFt
    from stage_hardware.drivers.pynetft_sensor import PynetftSensor


class NetFtConfig(WrenchSensorConfig):
    """A Net F/T box; its rate and ranges have to be those that are stated here."""

    host: str = Field(default="192.168.1.1", min_length=1, description="Its address.")
    rdt_port: int = Field(default=rdt.PORT, ge=1, le=65535, strict=True, description="The UDP port of its records.")
    http_port: int = Field(default=80, ge=1, le=65535, strict=True, description="The TCP port of its page.")
    bias_readings: int = Field(default=100, ge=1, strict=True, description="How many readings a bias is the mean of.")

    @property
    def address(self) -> str:
        """Host and ports."""
        return f"{self.host} (UDP {self.rdt_port}, TCP {self.http_port})"

    def emulate(self, name: str, wrench: Wrench) -> EmulatedDevice[ForceSensorConfig]:
        """Return an emulated box."""
        from stage_hardware.emulators.net_ft_box import NetFtBox

        fx, fy, fz = (largest / 1000 for largest in self.largest_force)
        box = NetFtBox(
            self._counted(wrench),
            rate_Hz=self.rate,
            forces_N=(fx, fy, fz),
            torques_Nmm=self.largest_torque,
        )
        return EmulatedDevice(
            box,
            lambda: self.model_copy(update={"host": box.host, "rdt_port": box.rdt_port, "http_port": box.http_port}),
        )

    def _settings(self) -> dict[str, Any]:
        return {
            "components": self.components,
            "rate_Hz": self.rate,
            "rdt_port": self.rdt_port,
            "http_port": self.http_port,
            "bias_readings": self.bias_readings,
        }


class AtiNetFtConfig(NetFtConfig):
    """A Net F/T box, read by the driver of the plugin."""

    type: Literal["stages.ati_net_ft"]

    def build(self, name: str) -> "AtiNetFt":
        """Return the driver."""
        from stage_hardware.drivers.ati_net_ft import AtiNetFt

        return AtiNetFt(name, self.host, **self._settings())


class PynetftConfig(NetFtConfig):
    """A Net F/T box, read by pynetft (extra `ati`)."""

    type: Literal["stages.pynetft"]

    def build(self, name: str) -> "PynetftSensor":
        """Return the driver."""
        from stage_hardware.drivers.pynetft_sensor import PynetftSensor

        return PynetftSensor(name, self.host, **self._settings())
