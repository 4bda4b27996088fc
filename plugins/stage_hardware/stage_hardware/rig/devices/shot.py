"""The configuration of SIGMA KOKI's controllers in SHOT mode."""

from typing import TYPE_CHECKING, Literal

from pydantic import Field

from neurorobo.config.experiment import Name
from stage_hardware.rig.device_config import StageConfig
from stage_hardware.rig.devices.sigma_koki import SigmaKokiAxisConfig, SigmaKokiConfig
from stage_hardware.rig.emulated_device import EmulatedStage

if TYPE_CHECKING:
    from stage_hardware.drivers.shot import ShotStage


class ShotConfig(SigmaKokiConfig):
    """A controller in SHOT mode."""

    type: Literal["stages.shot"]
    controller: Literal["SHOT-302GS", "SHOT-304GS", "SHOT-702", "GSC-01", "GSC-02"] = Field(description="Its model.")
    baud: int | None = Field(
        default=None, gt=0, strict=True, description="Bits per second; by default what the factory sets."
    )
    acknowledges: bool | None = Field(
        default=None, strict=True, description="Its switch ACK: true for MAIN, false for SUB; by default the factory's."
    )
    axes: dict[Name, SigmaKokiAxisConfig] = Field(min_length=1, description="Its axes, by names of their own.")

    def build(self, name: str) -> "ShotStage":
        """Return the driver."""
        from stage_hardware.drivers import shot

        known = (shot.SHOT_302GS, shot.SHOT_304GS, shot.SHOT_702, shot.GSC_01, shot.GSC_02)
        return shot.ShotStage(
            name,
            self.port,
            {key: axis.driver_axis() for key, axis in self.axes.items()},
            controller=next(model for model in known if model.name == self.controller),
            baud=self.baud,
            hardware_flow_control=self.hardware_flow_control,
            acknowledges=self.acknowledges,
        )

    def emulate(self, name: str) -> EmulatedStage[StageConfig]:
        """Return an emulator, as slow as its baud rate."""
        from stage_hardware.emulators.shot import ShotEmulator

        emulator = ShotEmulator(
            self.controller, acknowledges=self.acknowledges, wire=self._wire, baud=0 if self._is_tcp else self.baud
        )
        return self._emulated(emulator, self._mechanisms(emulator, self.build(name).speeds))
