"""The configuration of the arena; imports no torch."""

import itertools
from typing import Annotated, ClassVar, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from neurorobo.bodies import Actuator, BodyConfig, Sensor
from neurorobo.units import Duration, Unit

Share = Annotated[float, Field(ge=0, le=1)]
Waypoint = tuple[Share, Share]
WayPath = Annotated[tuple[Waypoint, ...], Field(min_length=2)]


class DrawnPaths(BaseModel):
    """Paths that each episode draws from its seed: straight stretches, none of which turns back sharply."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    number: int = Field(default=1, ge=1, description="The number of paths.")
    waypoints: int = Field(default=8, ge=2, description="The number of places of each path, its start included.")
    shortest: Annotated[float, Unit("m", gt=0)] = Field(default=0.25, description="The shortest stretch.")
    longest: Annotated[float, Unit("m", gt=0)] = Field(default=0.45, description="The longest stretch.")
    margin: Annotated[float, Unit("m", ge=0)] = Field(default=0.1, description="How far paths stay from the walls.")
    sharpest_turn: Annotated[float, Unit("deg", gt=0, le=180)] = Field(
        default=110.0, description="By how much the direction changes at most."
    )


class ArenaConfig(BodyConfig):
    """A square arena, in which an agent is led along paths, guided along them, and then walks them alone.

    An episode is a sequence of runs, each of which takes all paths in turn: ``led_runs`` times it is led, that is,
    moved; ``guided_runs`` times it walks by itself on a leash, and at last once without. Each way along a path begins
    with the ``cue``: the agent is held at the start.
    """

    implementation: ClassVar[str] = "neurorobo_paradigms.path_memory.arena:Arena"

    type: Literal["paradigms.arena"] = "paradigms.arena"
    side: Annotated[float, Unit("m", gt=0)] = Field(default=1.0, description="From wall to wall; 0 is one corner.")
    paths: tuple[WayPath, ...] | DrawnPaths = Field(
        default=DrawnPaths(),
        description="Each path as a list of places [x, y] in parts of the side, or what is drawn from the seed.",
    )
    led_runs: int = Field(default=1, ge=0, description="How often it is led along each path.")
    guided_runs: int = Field(default=6, ge=0, description="How often it then walks along each path on the leash.")
    speed: Annotated[float, Unit("m/s", gt=0)] = Field(default=0.3, description="How fast it is led.")
    cue: Annotated[Duration, Field(gt=0)] = Field(default=500_000_000, description="How long it is held at a start.")
    horizon: Annotated[Duration, Field(gt=0)] = Field(
        default=400_000_000, description="How far ahead the goal is: the time in which the agent would be there."
    )
    leash: Annotated[float, Unit("1/s", gt=0)] = Field(
        default=2.0,
        description="The speed at which it is drawn back to the path, for each metre it is off, unless alone.",
    )
    disturbance: Annotated[float, Unit("m/s", ge=0)] = Field(
        default=0.1, description="What pushes it about, unless it is alone: standard deviation, of either axis."
    )
    recall_disturbance: Annotated[float, Unit("m/s", ge=0)] = Field(
        default=0.0, description="The same while it walks alone."
    )
    start_offset: Annotated[float, Unit("m", ge=0)] = Field(
        default=0.0, description="How far from the start it is put before it walks alone, in a direction drawn."
    )
    sensor_noise: Annotated[float, Unit("m", ge=0)] = Field(
        default=0.0, description="Error of the sensed place, anew at each reading: standard deviation, of either axis."
    )
    recall_time: float = Field(
        default=1.25, gt=0, description="How long it may walk alone, in multiples of the time in which it is led."
    )

    @model_validator(mode="after")
    def _paths_can_be(self) -> Self:
        if isinstance(self.paths, DrawnPaths):
            drawn = self.paths
            if drawn.shortest > drawn.longest:
                raise ValueError(f"no stretch is between {drawn.shortest:g} and {drawn.longest:g} m; exchange them")
            if 2 * drawn.margin + drawn.longest > self.side:
                raise ValueError(
                    f"a stretch of {drawn.longest:g} m and a margin of {drawn.margin:g} m do not fit between walls "
                    f"{self.side:g} m apart; take a shorter one, a smaller margin or a larger `side`"
                )
            return self
        if not self.paths:
            raise ValueError("there is no path; give one or more")
        for number, path in enumerate(self.paths):
            if any(one == other for one, other in itertools.pairwise(path)):
                raise ValueError(f"path {number} names one place twice in a row; leave one of them out")
        return self

    def sensors(self) -> dict[str, Sensor]:
        """Return where it is, by how much its goal was wrong, and whether it is alone."""
        side = self.side
        return {
            "place": Sensor("m", 2, 0.0, side, description="Where the agent is, x and y."),
            "correction": Sensor(
                "m",
                2,
                -side,
                side,
                description="The place that it is led to, less its last goal; 0 while it is alone.",
            ),
            "alone": Sensor("1", 1, 0.0, 1.0, description="1 after a motion that it made alone, else 0."),
        }

    def actuators(self) -> dict[str, Actuator]:
        """Return the goal: the place to walk to, to be reached within the horizon."""
        return {"goal": Actuator("m", 2, 0.0, self.side, "hold", "The place to walk to, x and y.")}
