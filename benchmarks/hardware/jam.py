"""What a rig under test feels: a contact that can be made to jam while it is felt, and keeps what it was."""

import math
import time
from collections.abc import Mapping
from typing import ClassVar, Literal, NamedTuple

from stage_hardware.rig.physics import PhysicsConfig, Wrench


class Load(NamedTuple):
    """The true load at a moment of the monotonic clock: that across the insertion, and that along it."""

    time_ns: int
    radial_mN: float
    axial_mN: float


class JamConfig(PhysicsConfig):
    """An elastic contact along one axis, which pushes sideways as well."""

    implementation: ClassVar[str] = "jam:Jam"

    type: Literal["faults.jam"] = "faults.jam"
    at: float
    lateral_mN_um: float
    axial_mN_um: float


class Jam:
    """The load of the contact, and what comes on top: switches, which may be thrown from any thread.

    ``step`` is a load that is there at once and falls in proportion to the depth if there is one; ``rise`` is one that
    grows by so many mN/s up to a largest one; ``hard`` is a wall of another stiffness in mN/um from here on, upwards
    or downwards. ``felt`` keeps all loads.
    """

    def __init__(self, config: JamConfig) -> None:
        """Put it there."""
        self._config, self._axis = config, config.axes[0]
        self.felt: list[Load] = []
        self._place = self._depth = 0.0
        self._steps: tuple[tuple[float, float, float], ...] = ()  # radial, axial, the depth at which they are so large
        self._rise = (0.0, 0.0, 0.0)  # per s, at most, since
        self._hard = (0.0, 1, 0.0)  # stiffness, direction, from where

    def step(self, radial_mN: float, axial_mN: float = 0.0) -> None:
        """Let a load be there at once."""
        self._steps = (*self._steps, (radial_mN, axial_mN, self._depth))

    def rise(self, mN_s: float, most_mN: float) -> None:
        """Let a load grow from now on."""
        self._rise = mN_s, most_mN, time.monotonic()

    def hard(self, mN_um: float, direction: int) -> None:
        """Let a wall begin here."""
        self._hard = mN_um, direction, self._place

    @property
    def slopes_mN_um(self) -> tuple[float, float]:
        """How fast the load across and that along the insertion can rise with the way, from now on."""
        radial = sum(radial_mN / depth for radial_mN, _, depth in self._steps if depth)
        axial = sum(axial_mN / depth for _, axial_mN, depth in self._steps if depth)
        return self._config.lateral_mN_um + radial + self._hard[0], self._config.axial_mN_um + axial

    def wrench(self, positions: Mapping[str, float]) -> Wrench:
        """Return the load, and keep it."""
        self._place = positions[self._axis]
        self._depth = depth = max(0.0, self._place - self._config.at)
        radial_mN, axial_mN = self._config.lateral_mN_um * depth, self._config.axial_mN_um * depth
        for step_mN, axial_step_mN, full_depth in self._steps:
            share = depth / full_depth if full_depth else 1.0
            radial_mN, axial_mN = radial_mN + share * step_mN, axial_mN + share * axial_step_mN
        mN_s, most_mN, since_s = self._rise
        mN_um, direction, begins = self._hard
        radial_mN += min(most_mN, mN_s * (time.monotonic() - since_s)) if mN_s else 0.0
        radial_mN += mN_um * max(0.0, direction * (self._place - begins))
        self.felt.append(Load(time.monotonic_ns(), math.fabs(radial_mN), math.fabs(axial_mN)))
        return radial_mN, 0.0, axial_mN, 0.0, 0.0, 0.0
