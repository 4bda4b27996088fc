"""What an emulated rig feels: a wrench that follows from where its axes are."""

from abc import ABC
from collections.abc import Mapping
from typing import ClassVar, Protocol

from pydantic import BaseModel, ConfigDict, Field

Wrench = tuple[float, float, float, float, float, float]
"""Fx, Fy, Fz in mN, then Tx, Ty, Tz in mN*m."""


class Physics(Protocol):
    """The load on the force sensor of an emulated rig; it may remember what has been."""

    def wrench(self, positions: Mapping[str, float]) -> Wrench:
        """Return the load when the axes are at these positions: um, from where episodes begin, by the axes' names.

        It is called at the rate of the sensor while somebody reads it, in the order of time, from one thread.
        """


class PhysicsConfig(BaseModel, ABC):
    """Base of the configuration of every physics; ``implementation`` is its class, which is built from it alone."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    implementation: ClassVar[str]

    type: str
    axes: tuple[str, ...] = Field(description="The axes of the rig that it depends on, in the order of its own.")
