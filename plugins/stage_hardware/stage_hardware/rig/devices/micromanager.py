"""The configuration of stages of Micro-Manager."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from pydantic import Field

from neurorobo.config.experiment import Name
from stage_hardware.rig.device_config import AxisConfig, StageConfig

if TYPE_CHECKING:
    from stage_hardware.drivers.micromanager import MicroManagerAxis, MicroManagerStage


class MicroManagerAxisConfig(AxisConfig):
    """An axis of Micro-Manager; its speed is not set by it, but by a property of the device."""

    device: str = Field(min_length=1, description="The label of its device.")
    coordinate: Literal["", "x", "y"] = Field(default="", description="Which axis of an XY stage it is.")
    knows_its_position: bool = Field(
        default=False, strict=True, description="Whether it needs no home run, as with an absolute encoder."
    )

    def driver_axis(self) -> "MicroManagerAxis":
        """Return it as the driver takes it."""
        from stage_hardware.drivers.micromanager import MicroManagerAxis

        return MicroManagerAxis(self.axis, self.device, self.coordinate, self.knows_its_position)


class MicroManagerConfig(StageConfig):
    """Stages of one configuration of Micro-Manager (extra `mm`); they cannot be emulated."""

    type: Literal["stages.micromanager"]
    configuration: Path = Field(description="The configuration file, as seen from where the program is started.")
    properties: Mapping[str, Mapping[str, str]] = Field(
        default={}, description="Properties to set, by device: {XY: {Velocity: '2.0'}}."
    )
    adapter_paths: tuple[str, ...] = Field(default=(), description="More folders to look for adapters in.")
    axes: dict[Name, MicroManagerAxisConfig] = Field(min_length=1, description="Its axes, by names of their own.")

    @property
    def address(self) -> str:
        """The configuration file."""
        return str(self.configuration)

    def build(self, name: str) -> "MicroManagerStage":
        """Return the driver."""
        from stage_hardware.drivers.micromanager import MicroManagerStage

        return MicroManagerStage(
            name,
            {key: axis.driver_axis() for key, axis in self.axes.items()},
            configuration=self.configuration,
            properties={
                (device, key): value for device, values in self.properties.items() for key, value in values.items()
            },
            adapter_paths=self.adapter_paths,
        )
