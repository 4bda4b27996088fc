"""The configurations of Micos' controllers that speak Venus-1 (Corvus) and Venus-2 (Pollux, SMC)."""

from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from neurorobo.config.experiment import Name
from neurorobo.config.faults import validation_error
from neurorobo.errors import Fault
from neurorobo.units import Unit
from stage_hardware.rig.device_config import AxisConfig, SerialStageConfig, StageConfig
from stage_hardware.rig.emulated_device import EmulatedAxis, EmulatedStage

if TYPE_CHECKING:
    from stage_hardware.drivers.venus import Venus1Stage, Venus2Stage, VenusAxis

UM_PER_MM = 1000.0
REPLIES_AFTER_S = 0.001
"""How long an emulated controller takes for a reply; how long a device does is not known."""


class VenusAxisConfig(AxisConfig):
    """An axis of a Venus controller."""

    number: int = Field(ge=1, le=16, strict=True, description="Its connector, from 1.")
    origin: Annotated[float, Unit("um")] = Field(
        description="Where its lower switch is, in its own coordinates: travel ends above."
    )
    tolerance: Annotated[float, Unit("um", gt=0)] | None = Field(
        default=None, description="How far from its target it may rest; by default 5 steps."
    )

    @model_validator(mode="after")
    def _ends_above_its_switch(self) -> Self:
        if self.origin > self.travel.lo:
            fault = f"is within the travel of {self.travel.lo:g}..{self.travel.hi:g} um (got {self.origin:g} um)"
            raise validation_error([Fault(("origin",), fault)], type(self).__name__)
        return self

    def driver_axis(self) -> "VenusAxis":
        """Return it as the driver takes it."""
        from stage_hardware.drivers.venus import VenusAxis

        return VenusAxis(self.axis, self.number, self.origin, self.tolerance)


class VenusConfig(SerialStageConfig):
    """A controller of Micos."""

    venus: ClassVar[int]

    baud: int
    axes: dict[Name, VenusAxisConfig] = Field(min_length=1, description="Its axes, by names of their own.")

    def emulate(self, name: str) -> EmulatedStage[StageConfig]:
        """Return an emulator, as slow as its baud rate."""
        from stage_hardware.emulators import venus
        from stage_hardware.emulators.wire import PseudoTerminal

        stages = [venus.EmulatedStage()] * max(axis.number for axis in self.axes.values())
        for axis in self.axes.values():
            _, upper, position = axis.mechanics(axis.origin)
            stages[axis.number - 1] = venus.EmulatedStage(
                upper / UM_PER_MM, position / UM_PER_MM, speed=axis.speed / UM_PER_MM
            )
        emulator = venus.VenusEmulator(
            stages,
            venus=self.venus,
            wire=self._wire or PseudoTerminal,
            baud=0 if self._is_tcp else self.baud,
            processing_s=REPLIES_AFTER_S,
        )
        axes = {
            key: EmulatedAxis(emulator.axes[axis.number].mechanism, UM_PER_MM, axis.origin)
            for key, axis in self.axes.items()
        }
        return self._emulated(emulator, axes)


class Venus1Config(VenusConfig):
    """A Corvus; speed and acceleration are those of its slowest axis."""

    venus: ClassVar[int] = 1

    type: Literal["stages.venus_1"]
    baud: int = Field(default=57600, gt=0, strict=True, description="Bits per second.")

    @model_validator(mode="after")
    def _has_three_connectors(self) -> Self:
        faults = [
            Fault(("axes", name, "number"), f"a Corvus has connectors 1 to 3 (got {axis.number})")
            for name, axis in self.axes.items()
            if axis.number > 3
        ]
        if faults:
            raise validation_error(faults, self.type)
        return self

    def build(self, name: str) -> "Venus1Stage":
        """Return the driver."""
        from stage_hardware.drivers.venus import Venus1Stage

        axes = {key: axis.driver_axis() for key, axis in self.axes.items()}
        return Venus1Stage(name, self.port, axes, baud=self.baud)


class Venus2Config(VenusConfig):
    """A Pollux or an SMC, or several in a chain."""

    venus: ClassVar[int] = 2

    type: Literal["stages.venus_2"]
    baud: int = Field(default=19200, gt=0, strict=True, description="Bits per second.")

    def build(self, name: str) -> "Venus2Stage":
        """Return the driver."""
        from stage_hardware.drivers.venus import Venus2Stage

        axes = {key: axis.driver_axis() for key, axis in self.axes.items()}
        return Venus2Stage(name, self.port, axes, baud=self.baud)
