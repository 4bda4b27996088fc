"""The contact of an insertion along its way: what the force sensor of an emulated rig feels at any moment."""

import time
from bisect import bisect_left
from collections.abc import Callable, Mapping

import numpy as np

from precision_interaction.rig.contact_path_config import ContactPathConfig
from precision_interaction.rig.insertion_rig import build_contact

Vector = tuple[float, float, float]
NOTHING: Vector = (0.0, 0.0, 0.0)

FINEST_UM = 1e-6
"""A shorter way deeper is no way: rounding alone would draw noise."""


class ContactPath:
    """Eq. 1-2 for positions at any time, in place of moves: a force (mN) for each depth, drawn when it is reached.

    Going deeper than ever draws the increments of the law, in as many steps as there are calls; their mean and variance
    are those of one step. On the way back the force retraces, which makes a retraction lower it. An axis that stands
    still for ``rest`` ends an axial move. Once the peg is out of the hole the path is forgotten, and the next insertion
    draws a new one from the same generator.

    Radial axes are in line at 0. In contact a radial way takes off stiffness times its length, as in the simulation;
    out of it there is no force, where the simulation counts radial moves in the gap as well.
    """

    def __init__(self, config: ContactPathConfig, clock: Callable[[], int] = time.monotonic_ns) -> None:
        """Begin out of the hole; ``clock`` counts nanoseconds."""
        self._config, self._clock = config, clock
        self._contact = build_contact(config.body)
        self._generator = np.random.default_rng(config.seed)
        self._travel_um, self._moved_ns = 0.0, clock()
        first, second = np.zeros(1), np.ones(1)
        self._contact.increment_mN(first, second, first, np.zeros((1, 3)))  # or the first contact would wait for it
        self._forget()

    def wrench(self, positions: Mapping[str, float]) -> tuple[float, float, float, float, float, float]:
        """Return Fx, Fy, Fz in mN, and no torques, with the axes at these positions (um)."""
        travel_um, *stage_um = (positions[axis] for axis in self._config.axes)
        now_ns = self._clock()
        if travel_um != self._travel_um:
            if now_ns - self._moved_ns > self._config.rest:
                self._move_from_um = self._depths_um[-1]
            self._moved_ns = now_ns
        depth_um = travel_um - self._config.body.gap
        if depth_um <= 0:
            self._forget()
        else:
            self._go_to(depth_um)
            self._press(stage_um, travel_um)
        self._travel_um = travel_um
        if depth_um <= 0:
            return (*NOTHING, 0.0, 0.0, 0.0)
        x, y, z = self._force_mN(depth_um)
        return x + self._spring_mN[0], y + self._spring_mN[1], z, 0.0, 0.0, 0.0

    def _forget(self) -> None:
        self._depths_um: list[float] = [0.0]
        self._forces_mN: list[Vector] = [NOTHING]
        self._move_from_um = 0.0  # the depth, of those that were reached for the first time, where this move began
        self._stage_um, self._spring_mN = (0.0, 0.0), (0.0, 0.0)

    def _go_to(self, depth_um: float) -> None:
        """Draw the contact down to a depth that was not reached before."""
        deepest_um = self._depths_um[-1]
        if depth_um <= deepest_um + FINEST_UM:
            return
        before, after = deepest_um - self._move_from_um, depth_um - self._move_from_um
        increment_mN = self._contact.increment_mN(
            np.array([before]), np.array([after]), np.array([deepest_um]), self._generator.standard_normal((1, 3))
        )[0]
        x, y, z = (last + added for last, added in zip(self._forces_mN[-1], increment_mN.tolist(), strict=True))
        self._depths_um.append(depth_um)
        self._forces_mN.append((x, y, z))

    def _press(self, stage_um: list[float], travel_um: float) -> None:
        """Take off what the radial way since the last call, or since the start, does."""
        body = self._config.body
        stiffness_mN_um = body.stiffness
        if body.stiffness_change is not None and travel_um >= body.stiffness_change.at:
            stiffness_mN_um = body.stiffness_change.to
        (x, y), (last_x, last_y), (spring_x, spring_y) = stage_um, self._stage_um, self._spring_mN
        self._spring_mN = spring_x - stiffness_mN_um * (x - last_x), spring_y - stiffness_mN_um * (y - last_y)
        self._stage_um = x, y

    def _force_mN(self, depth_um: float) -> Vector:
        """Return the contact at a depth that was reached, linear between those that were drawn."""
        i = bisect_left(self._depths_um, depth_um)
        if i >= len(self._depths_um):
            return self._forces_mN[-1]
        if i == 0:
            return self._forces_mN[0]
        share = (depth_um - self._depths_um[i - 1]) / (self._depths_um[i] - self._depths_um[i - 1])
        x, y, z = (
            low + share * (high - low) for low, high in zip(self._forces_mN[i - 1], self._forces_mN[i], strict=True)
        )
        return x, y, z
