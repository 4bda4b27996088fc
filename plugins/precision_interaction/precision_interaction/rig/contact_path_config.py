"""The configuration of the contact that an emulated rig feels; imports no torch and builds nothing."""

from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, field_validator
from stage_hardware.rig.physics import PhysicsConfig

from neurorobo.units import Duration
from precision_interaction.rig.insertion_rig_config import InsertionRigConfig


class ContactPathConfig(PhysicsConfig):
    """The contact of a simulated insertion rig, felt by an emulated one along its way."""

    implementation: ClassVar[str] = "precision_interaction.rig.contact_path:ContactPath"

    type: Literal["precision.contact_path"] = "precision.contact_path"
    axes: tuple[str, str, str] = Field(default=("z", "x", "y"), description="The axial one, then the radial ones.")
    body: InsertionRigConfig = Field(
        default=InsertionRigConfig(),
        description="The simulated body, as under `body:` of an experiment; contact, gap and stiffness are its.",
    )
    seed: int = Field(default=0, ge=0, description="Draws the contact; one insertion after the other goes on from it.")
    rest: Annotated[Duration, Field(gt=0)] = Field(
        default=15_000_000,
        description="An axial move has ended when the axis has stood still for so long: what a law adds once per move "
        "is added when the next one begins.",
    )

    @field_validator("body", mode="before")
    @classmethod
    def _is_simulated(cls, value: Any) -> Any:
        if isinstance(value, dict) and value.get("type") != "precision.insertion_rig":
            raise ValueError("must be a `precision.insertion_rig`, whose contact is drawn from a law")
        return value
