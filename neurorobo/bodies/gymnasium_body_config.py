"""The configuration of a Gymnasium environment as a body; Gymnasium is imported when a file names one."""

from collections.abc import Iterable, Mapping
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from neurorobo.bodies.body import Actuator, BodyConfig, Sensor
from neurorobo.bodies.gymnasium_spaces import Bounds, Spaces, spaces
from neurorobo.errors import NeuroroboError
from neurorobo.units import KnownUnit, parse_interval

Elements = tuple[Annotated[int, Field(ge=0)], ...]


class EnvironmentChannel(BaseModel):
    """Some elements of the action, or of the observation, under a name."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    unit: KnownUnit = Field(default="1", description="The unit of the environment's numbers, such as N*m.")
    elements: Annotated[Elements, Field(min_length=1)] | None = Field(
        default=None, description="Which elements of the vector, from 0 on; all if left out."
    )

    def indices(self, bounds: Bounds) -> list[int]:
        """Return the elements, of those there are."""
        return list(range(len(bounds[0]))) if self.elements is None else list(self.elements)


class EnvironmentSensor(EnvironmentChannel):
    """Some elements of the observation, and what can be seen of them."""

    range: str | None = Field(
        default=None,
        description="What it can show, such as -10..10 rad/s; it saturates beyond. Elements without bounds need one.",
    )

    @model_validator(mode="after")
    def _in_unit(self) -> Self:
        if self.range is not None:
            parse_interval(self.range, self.unit)
        return self

    def ends(self, bounds: Bounds) -> tuple[float, float]:
        """Return the least and the largest that it can show."""
        if self.range is not None:
            interval = parse_interval(self.range, self.unit)
            return interval.lo, interval.hi
        return _ends(self.indices(bounds), bounds)


class GymnasiumBodyConfig(BodyConfig):
    """A Gymnasium environment, by its id: each body of a batch is an environment of its own.

    By default one sensor, ``observation``, and one actuator, ``action``, each of all elements of its space; what is
    not a vector is flattened as `gymnasium.spaces.flatten` does. Of discrete actions, an element is the preference for
    one, and the most preferred is taken.
    """

    implementation: ClassVar[str] = "neurorobo.bodies.gymnasium_body:GymnasiumBody"

    type: Literal["gymnasium_environment"] = "gymnasium_environment"
    environment: str = Field(
        description="The id, such as Pendulum-v1; `package:Name-v0` imports first what registers it."
    )
    kwargs: dict[str, Any] = Field(default={}, description="What `gymnasium.make` is given besides.")
    senses: dict[str, EnvironmentSensor] = Field(
        default={"observation": EnvironmentSensor()}, alias="sensors", min_length=1, description="The sensors, by name."
    )
    moves: dict[str, EnvironmentChannel] = Field(
        default={"action": EnvironmentChannel()},
        alias="actuators",
        min_length=1,
        description="The actuators, by name, which share the elements of the action.",
    )

    @model_validator(mode="after")
    def _fits_the_environment(self) -> Self:
        try:
            found = self.spaces
        except NeuroroboError as error:
            raise ValueError(str(error)) from error
        faults = [
            *_beyond("sensors", self.senses, found.observation),
            *_beyond("actuators", self.moves, found.action),
        ]
        faults = faults or [*self._unbounded(found.observation), *self._not_shared(found.action)]
        if faults:
            raise ValueError("; ".join(faults))
        return self

    @property
    def spaces(self) -> Spaces:
        """What the environment observes and does; a NeuroroboError if it cannot be made."""
        return spaces(self.environment, self.kwargs)

    def sensors(self) -> dict[str, Sensor]:
        """Return the sensors that the file names; each ranges over all that its elements do."""
        bounds = self.spaces.observation
        return {
            name: Sensor(each.unit, len(each.indices(bounds)), *each.ends(bounds)) for name, each in self.senses.items()
        }

    def actuators(self) -> dict[str, Actuator]:
        """Return the actuators that the file names; an action holds until the next one."""
        bounds = self.spaces.action
        elements = {name: each.indices(bounds) for name, each in self.moves.items()}
        return {
            name: Actuator(self.moves[name].unit, len(indices), *_ends(indices, bounds))
            for name, indices in elements.items()
        }

    def _unbounded(self, bounds: Bounds) -> Iterable[str]:
        """Yield the sensors with elements that have no bounds and are given none."""
        for name, sensor in self.senses.items():
            endless = [i for i in sensor.indices(bounds) if not np.isfinite([bounds[0][i], bounds[1][i]]).all()]
            if sensor.range is None and endless:
                yield (
                    f"`sensors.{name}`: elements {_listed(endless)} of the observation of `{self.environment}` "
                    f"have no bounds; give the sensor a `range`, such as `{{elements: [{endless[0]}], range: -10..10}}`"
                )

    def _not_shared(self, bounds: Bounds) -> Iterable[str]:
        """Yield the elements of the action that not exactly one actuator has."""
        taken = [i for actuator in self.moves.values() for i in actuator.indices(bounds)]
        if odd := [i for i in range(len(bounds[0])) if taken.count(i) != 1]:
            yield f"`actuators`: elements {_listed(odd)} of the action must each belong to one actuator"


def _ends(indices: list[int], bounds: Bounds) -> tuple[float, float]:
    return float(bounds[0][indices].min()), float(bounds[1][indices].max())


def _beyond(kind: str, channels: Mapping[str, EnvironmentChannel], bounds: Bounds) -> Iterable[str]:
    """Yield the channels with elements that there are not."""
    for name, channel in channels.items():
        if beyond := [i for i in channel.indices(bounds) if i >= len(bounds[0])]:
            yield f"`{kind}.{name}`: there are no elements {_listed(beyond)}; they count from 0 to {len(bounds[0]) - 1}"


def _listed(indices: list[int]) -> str:
    return ", ".join(map(str, indices))
