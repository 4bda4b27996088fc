"""The configuration of Physik Instrumente's controllers that speak the General Command Set 2.0."""

from typing import TYPE_CHECKING, Annotated, Literal, Self

from pydantic import Field, model_validator

from neurorobo.config.experiment import Name
from neurorobo.units import Unit
from stage_hardware.rig.device_config import AxisConfig, SerialStageConfig, StageConfig, refuse_twice
from stage_hardware.rig.emulated_device import EmulatedAxis, EmulatedStage

if TYPE_CHECKING:
    from stage_hardware.drivers.pi_gcs import PiAxis, PiStage

UM_PER_MM = 1000.0
REPLIES_AFTER_S = 0.0005
"""How long an emulated controller takes for a reply; how long a device does is not known."""


class PiAxisConfig(AxisConfig):
    """An axis of a PI controller."""

    identifier: str = Field(default="1", min_length=1, description="What the controller calls it.")
    reference: Literal["switch", "lower_limit", "upper_limit", "automatic_zero", "declared"] = Field(
        default="switch", description="How it finds its origin."
    )
    declared: Annotated[float, Unit("um")] = Field(
        default=0.0, description="Where it stands when it is homed, if that is only declared."
    )
    has_ramps: bool = Field(
        default=True, strict=True, description="Whether it takes accelerations; those of piezos do not."
    )
    limits_inverted: bool = Field(
        default=False, strict=True, description="Whether limit switches are 0 in the register when they are run onto."
    )

    def driver_axis(self) -> "PiAxis":
        """Return it as the driver takes it."""
        from stage_hardware.drivers.pi_gcs import PiAxis, Reference

        return PiAxis(
            self.axis,
            self.identifier,
            Reference[self.reference.upper()],
            self.declared,
            self.has_ramps,
            self.limits_inverted,
        )


class PiGcsConfig(SerialStageConfig):
    """A controller that speaks the General Command Set 2.0, on a serial line or over TCP."""

    type: Literal["stages.pi_gcs"]
    baud: int = Field(default=115200, gt=0, strict=True, description="Bits per second of a serial line.")
    identity: str = Field(default="", description="What it must call itself, such as its model or serial number.")
    has_status_register: bool = Field(
        default=True, strict=True, description="Whether its status register is laid out as that of the C-863."
    )
    axes: dict[Name, PiAxisConfig] = Field(min_length=1, description="Its axes, by names of their own.")

    @model_validator(mode="after")
    def _has_identifiers(self) -> Self:
        refuse_twice({name: axis.identifier for name, axis in self.axes.items()}, "identifier")
        return self

    def build(self, name: str) -> "PiStage":
        """Return the driver."""
        from stage_hardware.drivers.pi_gcs import C_863, PiStage

        return PiStage(
            name,
            self.port,
            {key: axis.driver_axis() for key, axis in self.axes.items()},
            baud=self.baud,
            identity=self.identity,
            status_bits=C_863 if self.has_status_register else None,
        )

    def emulate(self, name: str) -> EmulatedStage[StageConfig]:
        """Return an emulator; it is switched on where it is declared to be, if it is."""
        from stage_hardware.emulators import pi_gcs
        from stage_hardware.emulators.wire import PseudoTerminal

        stages = {}
        for axis in self.axes.values():
            lower, upper, position = axis.mechanics()
            lo, hi = min(axis.travel.lo, 0.0), max(axis.travel.hi, 0.0)
            stages[axis.identifier] = pi_gcs.EmulatedStage(
                lo / UM_PER_MM,
                hi / UM_PER_MM,
                (axis.declared if axis.reference == "declared" else position) / UM_PER_MM,
                max(lo - lower, upper - hi) / UM_PER_MM,
                axis.resolution / UM_PER_MM,
                2 * axis.speed / UM_PER_MM,
                axis.speed / UM_PER_MM,
                axis.acceleration / UM_PER_MM,
            )
        emulator = pi_gcs.PiEmulator(
            stages,
            wire=self._wire or PseudoTerminal,
            baud=0 if self._is_tcp else self.baud,
            processing_s=REPLIES_AFTER_S,
            model=self.identity or "C-863.11",
        )
        axes = {}
        for key, axis in self.axes.items():
            built = emulator.axes[axis.identifier]
            built.limits_inverted = axis.limits_inverted
            axes[key] = EmulatedAxis(built.mechanism, UM_PER_MM)
        return self._emulated(emulator, axes)
