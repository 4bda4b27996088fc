"""An elastic wall: the simplest physics there is."""

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from neurorobo.units import Unit
from stage_hardware.force_sensor import WRENCH
from stage_hardware.rig.physics import PhysicsConfig, Wrench


class WallConfig(PhysicsConfig):
    """A wall across one axis, which pushes back in proportion to how far the axis is beyond it."""

    implementation: ClassVar[str] = "stage_hardware.rig.wall:Wall"

    type: Literal["stages.wall"]
    axes: tuple[str, ...] = Field(min_length=1, max_length=1, description="The axis that runs into the wall: [z].")
    at: Annotated[float, Unit("um")] = Field(description="Where the wall begins, counted from where episodes begin.")
    stiffness: Annotated[float, Unit("mN/um")] = Field(description="Force per depth; its sign is that of the force.")
    component: Literal["Fx", "Fy", "Fz"] = Field(default="Fz", description="The component of the force.")


class Wall:
    """The force of a wall: its stiffness times the depth, none before it."""

    def __init__(self, config: WallConfig) -> None:
        """Put it there."""
        self._axis, self._at, self._stiffness = config.axes[0], config.at, config.stiffness
        self._component = WRENCH.index(config.component)

    def wrench(self, positions: Mapping[str, float]) -> Wrench:
        """Return the force at a depth."""
        force_mN = self._stiffness * max(0.0, positions[self._axis] - self._at)
        fx, fy, fz = (force_mN if component == self._component else 0.0 for component in range(3))
        return fx, fy, fz, 0.0, 0.0, 0.0
