"""The configuration of the insertion body on real stages; imports no drivers and connects nothing."""

from typing import Annotated, ClassVar, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from neurorobo.bodies.body import Sensor
from neurorobo.bodies.pacer import Overrun
from neurorobo.units import Unit
from precision_interaction.rig.insertion_body_config import InsertionBodyConfig

Signs = tuple[Literal[-1, 1], Literal[-1, 1]]


class Retraction(BaseModel):
    """How a peg that met too large a force is drawn back: along the way it came, as long as the force falls."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    distance: Annotated[float, Unit("um", gt=0)] = Field(
        default=200.0, description="Of the axis that goes farthest, at most."
    )
    step: Annotated[float, Unit("um", gt=0)] = Field(
        default=20.0, description="After each step of this length, the force must have fallen."
    )


class HardwareRigConfig(InsertionBodyConfig):
    """The insertion body on stages and a force sensor of a rig file, supervised and against the wall clock."""

    implementation: ClassVar[str] = "precision_interaction.rig.hardware_rig:HardwareRig"

    type: Literal["precision.hardware_rig"] = "precision.hardware_rig"
    rig: str = Field(
        description="The rig file. A relative path starts at the working directory of the run, not at the experiment."
    )
    axial: str = Field(default="z", description="The rig's axis of the insertion; deeper is up.")
    radial: tuple[str, str] = Field(default=("x", "y"), description="The rig's axes of the radial moves.")
    force: tuple[str, str] = Field(default=("Fx", "Fy"), description="The sensor's components along them.")
    force_signs: Signs = Field(default=(1, 1), description="-1 where a positive move raises the component.")
    axial_force: str = Field(default="Fz", description="The sensor's component along the insertion.")
    overrun: Overrun = Field(
        default="stop", description="What to do if a period takes too long: stop, hold the last command, or skip some."
    )
    following_error: Annotated[float, Unit("um", gt=0)] = Field(
        default=5.0, description="How far an axis may be from where it was sent, at the end of a period."
    )
    free_force: Annotated[float, Unit("mN", gt=0)] = Field(
        description="A larger load where the peg touches nothing, on the way to the start or in the gap, stops it."
    )
    retraction: Retraction = Retraction()
    at_end: Literal["withdraw", "stay"] = Field(
        default="withdraw",
        description="Where a run leaves the peg: drawn back along its way, so that the next run can home, or inserted.",
    )

    @model_validator(mode="after")
    def _has_limits(self) -> Self:
        limits = self.safety.get("force")
        missing = [name for name in ("stop", "latch", "rate", "age") if limits is None or getattr(limits, name) is None]
        if missing:
            raise ValueError(
                f"safety: real stages need limits of the force: {', '.join(f'`{name}`' for name in missing)} of "
                "`safety.force` missing; write e.g. {force: {stop: 2 N, latch: 4 N, rate: 20 N/s, age: 50 ms}}"
            )
        if len({self.axial, *self.radial}) < 3:
            raise ValueError("`axial` and `radial` name three axes")
        if len({self.axial_force, *self.force}) < 3:
            raise ValueError("`axial_force` and `force` name three components")
        return self

    def sensors(self) -> dict[str, Sensor]:
        """Those of every insertion body, and the force along the insertion."""
        force = self.force_range
        axial = Sensor("mN", 1, force.lo, force.hi, self.force_resolution, "Force along the insertion.")
        return {**super().sensors(), "axial_force": axial}
