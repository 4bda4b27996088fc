"""The configuration of SIGMA KOKI's controllers in HIT mode."""

from typing import TYPE_CHECKING, Literal, Self

from pydantic import Field, model_validator

from neurorobo.config.experiment import Name
from neurorobo.config.faults import validation_error
from neurorobo.errors import Fault
from stage_hardware.rig.device_config import StageConfig
from stage_hardware.rig.devices.sigma_koki import SigmaKokiAxisConfig, SigmaKokiConfig
from stage_hardware.rig.emulated_device import EmulatedStage

if TYPE_CHECKING:
    from stage_hardware.drivers.hit import HitStage

HSC_103_PULSES_PER_UM = 100


class HitConfig(SigmaKokiConfig):
    """A controller in HIT mode."""

    type: Literal["stages.hit"]
    controller: Literal["HSC-103", "HIT-M", "SHRC-203"] = Field(description="Its model.")
    baud: int = Field(default=38400, gt=0, strict=True, description="Bits per second.")
    axes: dict[Name, SigmaKokiAxisConfig] = Field(min_length=1, description="Its axes, by names of their own.")

    @model_validator(mode="after")
    def _counts_as_it_does(self) -> Self:
        faults = [
            Fault(("axes", name, "resolution"), f"an HSC-103 counts steps of 0.01 um (got {axis.resolution:g} um)")
            for name, axis in self.axes.items()
            if self.controller == "HSC-103" and axis.pulses_per_um != HSC_103_PULSES_PER_UM
        ]
        if faults:
            raise validation_error(faults, self.type)
        return self

    def build(self, name: str) -> "HitStage":
        """Return the driver."""
        from stage_hardware.drivers import hit

        return hit.HitStage(
            name,
            self.port,
            {key: axis.driver_axis() for key, axis in self.axes.items()},
            controller=next(model for model in (hit.HSC_103, hit.HIT_M, hit.SHRC_203) if model.name == self.controller),
            baud=self.baud,
            hardware_flow_control=self.hardware_flow_control,
        )

    def emulate(self, name: str) -> EmulatedStage[StageConfig]:
        """Return an emulator, as slow as its baud rate."""
        from stage_hardware.emulators.hit import HitEmulator

        emulator = HitEmulator(self.controller, wire=self._wire, baud=0 if self._is_tcp else self.baud)
        return self._emulated(emulator, self._mechanisms(emulator, self.build(name).speeds))
