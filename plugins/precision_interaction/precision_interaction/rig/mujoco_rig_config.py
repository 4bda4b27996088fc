"""The configuration of the insertion body whose contact MuJoCo solves; imports neither torch nor MuJoCo."""

from typing import Annotated, ClassVar, Literal, Self

from pydantic import BaseModel, Field, model_validator

from neurorobo.units import Interval, Unit, format_duration
from precision_interaction.rig.identified_law_config import IdentifiedContact, IdentifiedLawConfig
from precision_interaction.rig.insertion_body_config import InsertionBodyConfig, PositiveDuration
from precision_interaction.teachers.contact_expectation_config import ContactLawConfig

Stiffness = Annotated[float, Unit("mN/um", gt=0)]
Angle = Annotated[float, Unit("mrad")]
Wander = Annotated[float, Unit("um", ge=0)]

BEAD_RADIUS_UM = 10.0
"""Of the tip of each segment, which touches the peg."""

LONGEST_STEP_NS = 5_000_000
"""MuJoCo wants contacts that are twice as slow as its steps, and they are to be as hard whatever the step."""


class MujocoRigConfig(InsertionBodyConfig):
    """The insertion body whose contact MuJoCo solves: a peg on a compliant tool, a hole of layered compliant rings.

    A positive tilt or wander moves a ring's centre towards positive x or y, and so the force.
    """

    implementation: ClassVar[str] = "precision_interaction.rig.mujoco_rig:MujocoRig"

    type: Literal["precision.mujoco_rig"] = "precision.mujoco_rig"
    contact: IdentifiedContact | None = Field(
        default=None,
        description="What `neurorobo identify` found on this rig. It leaves the physics alone: in training it is what "
        "the teacher `precision.law` teaches.",
    )
    force_range: Annotated[Interval, Unit("mN")] = Field(
        default=Interval(-250.0, 250.0), description="The sensor saturates beyond it."
    )
    tool_stiffness: Stiffness = Field(
        default=88.0, description="Between stage and peg, radially. Rings in series make it softer, friction stiffer."
    )
    segment_stiffness: Stiffness = Field(default=300.0, description="Of each of a ring's four segments, radially.")
    interference: Annotated[float, Unit("um", gt=0, lt=BEAD_RADIUS_UM)] = Field(
        default=1.0, description="How far the peg presses each segment outward: half of what it is too wide."
    )
    ring_pitch: Annotated[float, Unit("um", gt=0)] = Field(
        default=5.0, description="Mean axial distance from ring to ring."
    )
    friction: Annotated[float, Unit("1", ge=0)] = Field(default=0.1, description="Coulomb's, of peg and segments.")
    tilt: tuple[Angle, Angle] = Field(
        default=(6.25, 12.5), description="Of the hole's axis against the elevator's, towards x and y."
    )
    wander: tuple[Wander, Wander] = Field(
        default=(0.42, 0.28),
        description="How far the centres of the rings have strayed from the hole's axis after 1 mm: the standard "
        "deviation of a random walk, in x and y.",
    )
    time_step: PositiveDuration = Field(
        default=LONGEST_STEP_NS, description="MuJoCo's, at most 5 ms; every period is a multiple of it."
    )

    @model_validator(mode="after")
    def _resolved(self) -> Self:
        if self.time_step > LONGEST_STEP_NS:
            raise ValueError(
                f"time_step ({format_duration(self.time_step)}) must be at most {format_duration(LONGEST_STEP_NS)}"
            )
        if self.axial_period % self.time_step:
            raise ValueError(
                f"axial_period ({format_duration(self.axial_period)}) must be a multiple of time_step "
                f"({format_duration(self.time_step)})"
            )
        if self.max_speed * self.time_step * 1e-9 > self.ring_pitch:
            raise ValueError(
                f"at max_speed ({self.max_speed:g} um/s) a time_step ({format_duration(self.time_step)}) passes more "
                f"than one ring_pitch ({self.ring_pitch:g} um); shorten it"
            )
        return self

    def tell(self, part: BaseModel) -> BaseModel:
        """Let `precision.law` teach the contact that was identified, if there is one."""
        if self.contact is None or not isinstance(part, ContactLawConfig):
            return part
        same = {name: getattr(part, name) for name in ("period", "start_speed", "axial_period")}
        return IdentifiedLawConfig.model_construct(contact=self.contact, **same)
