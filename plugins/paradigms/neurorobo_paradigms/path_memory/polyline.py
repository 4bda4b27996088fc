"""A path as straight stretches between places."""

from dataclasses import dataclass

import numpy as np

from neurorobo.bodies import Array
from neurorobo.errors import NeuroroboError
from neurorobo_paradigms.path_memory.arena_config import DrawnPaths

PATHS_TO_TRY = 1000
STRETCHES_TO_TRY = 20
"""For each waypoint, before a path begins anew: in a corner there may be no way on."""


@dataclass(frozen=True)
class Polyline:
    """Places (waypoints, 2) in m, and how far along the path each of them is (waypoints), in m."""

    waypoints_m: Array
    along_m: Array

    @staticmethod
    def through(waypoints_m: Array) -> "Polyline":
        """Return the path through places (waypoints, 2)."""
        stretches_m = np.hypot(*np.diff(waypoints_m, axis=0).T)
        return Polyline(waypoints_m, np.concatenate([[0.0], np.cumsum(stretches_m)]))

    @property
    def length_m(self) -> float:
        """The length from start to end."""
        return float(self.along_m[-1])

    def at(self, along_m: float) -> Array:
        """Return the place (2) that far along; the ends hold beyond them."""
        x, y = self.waypoints_m.T
        return np.array([np.interp(along_m, self.along_m, x), np.interp(along_m, self.along_m, y)])

    def distance_m(self, place_m: Array, stretch: int) -> float:
        """Return how far a place (2) is from the stretch that leads to a waypoint, by its number from 1 on."""
        start_m, end_m = self.waypoints_m[stretch - 1 : stretch + 1]
        way_m = end_m - start_m
        share = np.clip((place_m - start_m) @ way_m / (way_m @ way_m), 0.0, 1.0)
        return float(np.hypot(*(place_m - start_m - share * way_m)))


def draw_path(drawn: DrawnPaths, side_m: float, generator: np.random.Generator) -> Polyline:
    """Draw a path, whose stretches may cross; a NeuroroboError if none is found."""
    for _ in range(PATHS_TO_TRY):
        if (path := _try_path(drawn, side_m, generator)) is not None:
            return path
    raise NeuroroboError("no path of such stretches was found in the arena; allow shorter ones or sharper turns")


def _try_path(drawn: DrawnPaths, side_m: float, generator: np.random.Generator) -> Polyline | None:
    """Draw stretch by stretch; None where there is no way on."""
    lo_m, hi_m = drawn.margin, side_m - drawn.margin
    waypoints_m = [generator.uniform(lo_m, hi_m, 2)]
    heading, turn = 0.0, np.pi
    for _ in range(STRETCHES_TO_TRY * drawn.waypoints):
        tried = heading + generator.uniform(-turn, turn)
        step_m = generator.uniform(drawn.shortest, drawn.longest)
        next_m = waypoints_m[-1] + step_m * np.array([np.cos(tried), np.sin(tried)])
        if ((next_m >= lo_m) & (next_m <= hi_m)).all():
            waypoints_m.append(next_m)
            heading, turn = tried, np.deg2rad(drawn.sharpest_turn)
        if len(waypoints_m) == drawn.waypoints:
            return Polyline.through(np.array(waypoints_m))
    return None
