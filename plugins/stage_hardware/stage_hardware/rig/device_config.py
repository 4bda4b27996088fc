"""What a rig file says of a device: bases of all configurations of stages and force sensors."""

from abc import ABC, abstractmethod
from collections.abc import Hashable, Mapping
from fractions import Fraction
from typing import Annotated, NamedTuple, Self

from pydantic import BaseModel, ConfigDict, Field, StrictBool, model_validator

from neurorobo.config.experiment import Name
from neurorobo.config.faults import validation_error
from neurorobo.errors import Fault, NeuroroboError
from neurorobo.units import Interval, Unit
from stage_hardware.emulators.emulator import Emulator
from stage_hardware.emulators.wire import TcpPort, Wire
from stage_hardware.emulators.wrench import Wrench
from stage_hardware.force_sensor import ForceSensor
from stage_hardware.rig.emulated_device import EmulatedAxis, EmulatedDevice, EmulatedStage
from stage_hardware.rig.rig import Frame
from stage_hardware.stage import Axis, Stage

WireKind = type[Wire]  # the field `type` of a device hides the name


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Mechanics(NamedTuple):
    """How an emulated axis is built, in um from its origin: its switches, and where it is switched on."""

    lower_switch: float
    upper_switch: float
    position: float


class AxisConfig(_Strict):
    """What every axis has; positions are its own coordinates, which count from its origin."""

    travel: Annotated[Interval, Unit("um")] = Field(description="Its least and its largest position: -5..5 mm.")
    resolution: Annotated[float, Unit("um", gt=0)] = Field(description="Its step; of a stepper, that of one pulse.")
    speed: Annotated[float, Unit("um/s", gt=0)] = Field(description="The speed at which it moves.")
    acceleration: Annotated[float, Unit("um/s^2", gt=0)] = Field(description="How fast it comes to that speed.")
    start: Annotated[float, Unit("um")] = Field(description="Where episodes begin: position 0 of the rig.")
    inverted: StrictBool = Field(default=False, description="Whether positions of the rig grow against the axis.")

    @model_validator(mode="after")
    def _starts_within_travel(self) -> Self:
        if not self.travel.lo <= self.start <= self.travel.hi:
            fault = f"is beyond the travel of {self.travel.lo:g}..{self.travel.hi:g} um (got {self.start:g} um)"
            raise validation_error([Fault(("start",), fault)], type(self).__name__)
        return self

    @property
    def axis(self) -> Axis:
        """What the axis can do."""
        return Axis("um", self.travel.lo, self.travel.hi, self.resolution, self.speed, self.acceleration)

    @property
    def frame(self) -> Frame:
        """How the rig counts it."""
        return Frame(self.start, self.inverted)

    @property
    def pulses_per_um(self) -> Fraction:
        """How many steps a um has, exactly."""
        return 1 / Fraction(repr(self.resolution))

    def nearest_step(self, position: float) -> float:
        """Return the position of the step that is nearest."""
        return float(round(Fraction(position) * self.pulses_per_um) / self.pulses_per_um)

    def mechanics(self, origin: float = 0.0) -> Mechanics:
        """Return how to build it: switches beyond travel and origin, switched on a tenth of the longer way away."""
        ends = self.travel.lo - origin, self.travel.hi - origin
        beyond = (ends[1] - ends[0]) / 20
        return Mechanics(min(0.0, ends[0]) - beyond, max(0.0, ends[1]) + beyond, max(ends, key=abs) / 10)


class DeviceConfig(_Strict, ABC):
    """Base of the configuration of every device, which is registered under its ``type``."""

    type: str

    @property
    @abstractmethod
    def address(self) -> str:
        """Where it is found, for people to read; empty for a device that only this process can reach."""


class StageConfig(DeviceConfig, ABC):
    """A controller and its axes."""

    axes: Mapping[Name, AxisConfig] = Field(min_length=1, description="Its axes, by names of their own.")

    @abstractmethod
    def build(self, name: str) -> Stage:
        """Return the driver; nothing is connected. A ValueError for what its controller cannot do."""

    def emulate(self, name: str) -> EmulatedStage["StageConfig"]:
        """Return an emulator of the controller, not referenced and away from its origins."""
        raise NeuroroboError(f"{name}: {self.type} has no emulator; put a controller that has one in its place")

    @model_validator(mode="after")
    def _can_be_built(self) -> Self:
        self.build(self.type)
        return self


class SerialStageConfig(StageConfig, ABC):
    """A controller on a line of bytes."""

    port: str = Field(min_length=1, description="/dev/ttyUSB0, COM3, or a URL such as socket://192.168.0.1:50000.")

    @property
    def address(self) -> str:
        """The port."""
        return self.port

    @property
    def _is_tcp(self) -> bool:
        return self.port.startswith("socket://")

    @property
    def _wire(self) -> WireKind | None:
        """What its emulator answers on: a pseudo-terminal, where there are any, in place of a serial port."""
        return TcpPort if self._is_tcp else None

    def _emulated(self, emulator: Emulator, axes: Mapping[str, EmulatedAxis]) -> EmulatedStage[StageConfig]:
        return EmulatedStage(emulator, lambda: self.model_copy(update={"port": emulator.url}), axes)


class ForceSensorConfig(DeviceConfig, ABC):
    """A force sensor."""

    @abstractmethod
    def build(self, name: str) -> ForceSensor:
        """Return the driver; nothing is connected. A ValueError for what its sensor cannot do."""

    def emulate(self, name: str, wrench: Wrench) -> EmulatedDevice["ForceSensorConfig"]:
        """Return an emulator of the sensor under a load."""
        raise NeuroroboError(f"{name}: {self.type} has no emulator; put a sensor that has one in its place")

    @model_validator(mode="after")
    def _can_be_built(self) -> Self:
        self.build(self.type)
        return self


def refuse_twice(values: Mapping[str, Hashable], key: str) -> None:
    """Refuse axes that share what has to be their own: the value of each under ``key``, by the names of the axes."""
    first: dict[Hashable, str] = {}
    for name, value in values.items():
        first.setdefault(value, name)
    faults = [
        Fault(("axes", name, key), f"is that of axis `{first[value]}` too (got {value}); each axis has its own")
        for name, value in values.items()
        if first[value] != name
    ]
    if faults:
        raise validation_error(faults, key)
