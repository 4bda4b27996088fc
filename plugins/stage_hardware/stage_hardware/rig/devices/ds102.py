"""The configuration of Suruga Seiki's DS102 and DS112."""

import math
from typing import TYPE_CHECKING, Annotated, Literal, Self

from pydantic import Field, model_validator

from neurorobo.config.experiment import Name
from neurorobo.units import Unit
from stage_hardware.rig.device_config import AxisConfig, SerialStageConfig, StageConfig, refuse_twice
from stage_hardware.rig.emulated_device import EmulatedAxis, EmulatedStage

if TYPE_CHECKING:
    from stage_hardware.drivers.ds102 import DS102Axis, DS102Stage

AT_LOWER_SWITCH, AT_UPPER_SWITCH = (5, 11), (6, 12)
"""Origin types whose origin is the edge of a limit switch, a full step from where it begins."""


class DS102AxisConfig(AxisConfig):
    """An axis of a DS102; its resolution is that of a pulse."""

    number: int = Field(ge=1, le=6, strict=True, description="Its connector, from 1.")
    origin_type: int = Field(ge=1, le=12, strict=True, description="How it finds its origin: MEMSW0 of the manual.")
    start_speed: Annotated[float, Unit("um/s", gt=0)] | None = Field(
        default=None, description="The speed that is reached at once; by default 100 pulses per second."
    )
    s_curve_percent: int = Field(default=0, ge=0, le=100, strict=True, description="How much of a ramp is rounded.")
    drive_division: int | None = Field(
        default=None, ge=0, le=15, strict=True, description="DRDIV, the index of the division of a full step, if set."
    )

    def driver_axis(self) -> "DS102Axis":
        """Return it as the driver takes it."""
        from stage_hardware.drivers.ds102 import DS102Axis

        return DS102Axis(
            self.axis,
            self.number,
            self.pulses_per_um,
            self.origin_type,
            100 if self.start_speed is None else math.floor(self.start_speed * self.pulses_per_um),
            self.s_curve_percent,
            self.drive_division,
        )


class DS102Config(SerialStageConfig):
    """A DS102 or DS112."""

    type: Literal["stages.ds102"]
    baud: int = Field(default=38400, gt=0, strict=True, description="Bits per second.")
    axes: dict[Name, DS102AxisConfig] = Field(min_length=1, description="Its axes, by names of their own.")

    @model_validator(mode="after")
    def _has_connectors(self) -> Self:
        refuse_twice({name: axis.number for name, axis in self.axes.items()}, "number")
        return self

    def build(self, name: str) -> "DS102Stage":
        """Return the driver."""
        from stage_hardware.drivers.ds102 import DS102Stage

        axes = {key: axis.driver_axis() for key, axis in self.axes.items()}
        return DS102Stage(name, self.port, axes, baud=self.baud)

    def emulate(self, name: str) -> EmulatedStage[StageConfig]:
        """Return an emulator, which takes 50 ms for each reply, as one device was seen to."""
        from stage_hardware.emulators.ds102 import DS102Emulator
        from stage_hardware.emulators.ds102_axis import DIVISIONS

        # A mechanism counts full steps.
        um_per_step = {
            axis.number: DIVISIONS[axis.drive_division or 0] * axis.resolution for axis in self.axes.values()
        }
        mechanics = {
            axis.number: [um / um_per_step[axis.number] for um in axis.mechanics()] for axis in self.axes.values()
        }
        numbers = range(1, max(mechanics) + 1)
        emulator = DS102Emulator(
            [mechanics[number][2] if number in mechanics else 200.0 for number in numbers],
            connectors=next(count for count in (2, 4, 6) if count >= len(numbers)),
            has_micro_steps=any(axis.drive_division is not None for axis in self.axes.values()),
            wire=self._wire,
            baud=0 if self._is_tcp else self.baud,
        )
        axes = {}
        for key, axis in self.axes.items():
            mechanism = emulator.axes[axis.number - 1]
            mechanism.lower_switch, mechanism.upper_switch, _ = mechanics[axis.number]
            if axis.origin_type in AT_LOWER_SWITCH:
                mechanism.lower_switch = -1.0
            elif axis.origin_type in AT_UPPER_SWITCH:
                mechanism.upper_switch = 1.0
            axes[key] = EmulatedAxis(mechanism, um_per_step[axis.number])
        return self._emulated(emulator, axes)
