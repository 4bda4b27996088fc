"""The configuration of the turntable: the protocol of an experiment, and the eye; imports no torch."""

import math
from typing import Annotated, ClassVar, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from neurorobo.bodies import Actuator, BodyConfig, Sensor
from neurorobo.units import Duration, Unit

Name = Annotated[str, Field(pattern=r"^[A-Za-z]\w*$")]


class Phase(BaseModel):
    """A part of the protocol: one rotation of the head, in the dark or before a screen."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    frequency: Annotated[float, Unit("Hz", gt=0)] = Field(default=1.0, description="How often the head turns.")
    amplitude: Annotated[float, Unit("deg", gt=0)] = Field(
        default=5.0, description="How far it turns to either side; its largest velocity is 2 pi frequency amplitude."
    )
    wanted_gain: float | None = Field(
        default=None,
        description="The gain of the reflex at which the image stands still: the screen turns with the head at (1 - "
        "wanted gain) of its velocity. In the dark if left out.",
    )
    cycles: int | None = Field(default=None, ge=1, description="For how many cycles of the rotation it lasts.")
    duration: Annotated[Duration, Field(gt=0)] | None = Field(default=None, description="Or for how long it lasts.")

    @model_validator(mode="after")
    def _has_one_length(self) -> Self:
        if (self.cycles is None) == (self.duration is None):
            raise ValueError("say how long the phase lasts, either as `cycles: 60` or as `duration: 60 s`")
        return self

    @property
    def duration_ns(self) -> int:
        """How long it lasts."""
        return self.duration or round((self.cycles or 0) / self.frequency * 1e9)


class TurntableConfig(BodyConfig):
    """A head that is turned to and fro, a striped screen around it that turns too, and an eye that is commanded.

    The head counts positive to the left, eye and image to the right, so that a perfect reflex has a gain of 1.
    """

    implementation: ClassVar[str] = "neurorobo_paradigms.vestibulo_ocular.turntable:Turntable"

    type: Literal["paradigms.turntable"] = "paradigms.turntable"
    phases: dict[Name, Phase] = Field(min_length=1, description="The protocol: its phases by name, in order.")
    time_constant: Annotated[Duration, Field(gt=0)] = Field(
        default=5_000_000, description="With which the velocity of the eye follows its command."
    )
    largest_velocity: Annotated[float, Unit("deg/s", gt=0)] = Field(
        default=300.0, description="The largest velocity that the eye can be commanded, to either side."
    )
    slip_noise: Annotated[float, Unit("deg/s", ge=0)] = Field(
        default=0.0, description="Standard deviation of what is told of the slip, drawn anew at each motion in light."
    )

    @property
    def duration_ns(self) -> int:
        """How long all phases last."""
        return sum(phase.duration_ns for phase in self.phases.values())

    def sensors(self) -> dict[str, Sensor]:
        """Return the velocities of head, eye and image."""
        fastest = max(2 * math.pi * phase.frequency * phase.amplitude for phase in self.phases.values())
        return {
            "head": Sensor("deg/s", 1, -fastest, fastest, description="Velocity of the head to the left."),
            "eye": Sensor("deg/s", 1, description="Velocity of the eye in the head, to the right."),
            "slip": Sensor(
                "deg/s",
                2,
                description="Velocity of the image over the retina to the left and to the right, one the negative of "
                "the other; 0 in the dark.",
            ),
        }

    def actuators(self) -> dict[str, Actuator]:
        """Return the muscles of the eye."""
        fastest = self.largest_velocity
        return {"eye": Actuator("deg/s", 1, -fastest, fastest, "hold", "Wanted velocity of the eye to the right.")}
