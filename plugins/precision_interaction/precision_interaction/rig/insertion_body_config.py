"""What the configurations of all insertion bodies have in common; imports no torch and builds nothing."""

import math
from typing import Annotated, Self

from pydantic import Field, model_validator

from neurorobo.bodies.body import Actuator, BodyConfig, Sensor
from neurorobo.units import Duration, Interval, Unit
from precision_interaction import table_one

PositiveDuration = Annotated[Duration, Field(gt=0)]


class InsertionBodyConfig(BodyConfig):
    """A peg on a radial x-y stage, a hole on an axial elevator, and a force sensor (Table I, Sec. VI-B)."""

    length: Annotated[float, Unit("um", gt=0)] = Field(
        default=table_one.LENGTH_UM, description="l: the axial travel to the end of the insertion, the gap included."
    )
    gap: Annotated[float, Unit("um", ge=0)] = Field(
        default=table_one.GAP_UM, description="Axial travel before the two parts touch."
    )
    stage_resolution: Annotated[float, Unit("um", ge=0)] = Field(
        default=table_one.STAGE_RESOLUTION_UM, description="Radial targets are rounded to it; 0 for a continuous one."
    )
    elevator_resolution: Annotated[float, Unit("um", ge=0)] = Field(
        default=table_one.ELEVATOR_RESOLUTION_UM,
        description="Axial positions are rounded to it; 0 for a continuous one.",
    )
    force_resolution: Annotated[float, Unit("mN", ge=0)] = Field(
        default=table_one.FORCE_RESOLUTION_MN, description="The sensor's count; 0 for a continuous sensor."
    )
    force_range: Annotated[Interval, Unit("mN")] = Field(
        default=Interval(-36000.0, 36000.0), description="The sensor saturates beyond it."
    )
    max_speed: Annotated[float, Unit("um/s", gt=0)] = Field(
        default=table_one.MAX_SPEED_UM_S, description="Largest axial speed."
    )
    max_acceleration: Annotated[float, Unit("um/s^2", gt=0)] = Field(
        default=table_one.MAX_ACCELERATION_UM_S2, description="Largest change of the axial speed from move to move."
    )
    creep_speed: Annotated[float, Unit("um/s", gt=0)] = Field(
        default=table_one.CREEP_SPEED_UM_S, description="Least axial speed; only the last move may be slower."
    )
    max_radial_move: Annotated[float, Unit("um", gt=0)] = Field(
        default=25.0, description="Largest radial move of one command, per axis."
    )
    axial_period: PositiveDuration = Field(
        default=1_000_000_000, description="The time for which one axial speed is held: one move of the elevator."
    )

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.gap >= self.length:
            raise ValueError(f"the gap ({self.gap:g} um) must be shorter than the whole length ({self.length:g} um)")
        if self.creep_speed > self.max_speed:
            raise ValueError(f"creep_speed ({self.creep_speed:g} um/s) exceeds max_speed ({self.max_speed:g} um/s)")
        return self

    def sensors(self) -> dict[str, Sensor]:
        """Radial force, and the axial distance that is left and behind."""
        force = self.force_range
        step = self.elevator_resolution
        return {
            "force": Sensor("mN", 2, force.lo, force.hi, self.force_resolution, "Radial force x, y."),
            "remaining": Sensor("um", 1, -math.inf, self.length, step, "Axial distance left to the end."),
            "travel": Sensor("um", 1, 0.0, math.inf, step, "Axial distance behind, the gap included."),
            "stage": Sensor("um", 2, resolution=self.stage_resolution, description="Radial position x, y read back."),
        }

    def actuators(self) -> dict[str, Actuator]:
        """Axial speed, held for one axial period, and radial moves."""
        move = self.max_radial_move
        return {
            "axial_speed": Actuator("um/s", 1, 0.0, self.max_speed, "hold", "Speed of the insertion."),
            "radial_move": Actuator("um", 2, -move, move, "increment", "Radial move; a positive one lowers the force."),
        }
