"""The configuration of a stage without a wire, for rigs without devices."""

from contextlib import nullcontext
from typing import TYPE_CHECKING, Literal

from pydantic import Field, PrivateAttr

from neurorobo.config.experiment import Name
from stage_hardware.rig.device_config import AxisConfig, StageConfig
from stage_hardware.rig.emulated_device import EmulatedAxis, EmulatedStage

if TYPE_CHECKING:
    from stage_hardware.emulators.mock_stage import MockStage


class MockStageConfig(StageConfig):
    """Axes that move in this process; no other program can reach them."""

    type: Literal["stages.mock_stage"]
    axes: dict[Name, AxisConfig] = Field(min_length=1, description="Its axes, by names of their own.")

    _emulated: "MockStage | None" = PrivateAttr(default=None)

    @property
    def address(self) -> str:
        """It has none."""
        return ""

    def build(self, name: str) -> "MockStage":
        """Return a stage: that of the emulator, if this is its configuration."""
        from stage_hardware.emulators.mock_stage import MockStage

        if self._emulated is not None:
            return self._emulated
        mechanics = {key: axis.mechanics() for key, axis in self.axes.items()}
        return MockStage(
            name,
            {key: axis.axis for key, axis in self.axes.items()},
            positions={key: built.position for key, built in mechanics.items()},
            beyond=max((axis.travel.hi - axis.travel.lo) / 20 for axis in self.axes.values()),
        )

    def emulate(self, name: str) -> EmulatedStage[StageConfig]:
        """Return a stage that is its own emulator."""
        stage, config = self.build(name), self.model_copy()
        config._emulated = stage
        axes = {key: EmulatedAxis(mechanism) for key, mechanism in stage.mechanisms.items()}
        return EmulatedStage(stage, lambda: config, axes, nullcontext())
