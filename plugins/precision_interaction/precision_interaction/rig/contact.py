"""Contact laws: how much force an insertion adds (Eq. 1-2, Fig. 9-10), in mN for distances in um.

A law speaks of one axial move: the mean and variance of the force added after its first d um. What a stretch of the
move adds is the difference of two such values, so an intercept comes once per axial move, however fast the radial loop.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Vector = tuple[float, float, float]  # x, y, z; only the radial pair x, y is planned and compensated


class Law(Protocol):
    """Mean (mN) and variance (mN^2) per axis, (batch, 3), added by the first distance_um (batch,) of one axial move."""

    def mean_mN(self, distance_um: Array) -> Array:
        """Mean force (batch, 3)."""

    def variance_mN2(self, distance_um: Array) -> Array:
        """Variance (batch, 3)."""


@dataclass(frozen=True)
class Line:
    """Intercept plus slope times distance, nothing at distance 0; proportional (Eq. 8) without an intercept."""

    mean_slope_mN_um: Vector
    variance_slope_mN2_um: Vector
    mean_intercept_mN: Vector = (0.0, 0.0, 0.0)
    variance_intercept_mN2: Vector = (0.0, 0.0, 0.0)

    def mean_mN(self, distance_um: Array) -> Array:
        """Mean force (batch, 3)."""
        return _line(distance_um, self.mean_slope_mN_um, self.mean_intercept_mN)

    def variance_mN2(self, distance_um: Array) -> Array:
        """Variance (batch, 3)."""
        return _line(distance_um, self.variance_slope_mN2_um, self.variance_intercept_mN2)


def _line(distance_um: Array, slope: Vector, intercept: Vector) -> Array:
    moved = distance_um[:, None] > 0
    return np.where(moved, np.asarray(intercept) + np.asarray(slope) * distance_um[:, None], 0.0)


@dataclass(frozen=True)
class Table:
    """Piecewise linear through measured points, from (0, 0) on; beyond the last point its last segment goes on."""

    distance_um: tuple[float, ...]
    means_mN: tuple[Vector, ...]
    variances_mN2: tuple[Vector, ...]

    def mean_mN(self, distance_um: Array) -> Array:
        """Mean force (batch, 3)."""
        return _interpolate(distance_um, self.distance_um, self.means_mN)

    def variance_mN2(self, distance_um: Array) -> Array:
        """Variance (batch, 3)."""
        return _interpolate(distance_um, self.distance_um, self.variances_mN2)


def _interpolate(distance_um: Array, points_um: Sequence[float], values: Sequence[Vector]) -> Array:
    x = np.array([0.0, *points_um])
    y = np.array([(0.0, 0.0, 0.0), *values])
    left = np.clip(np.searchsorted(x, distance_um, side="right") - 1, 0, len(x) - 2)
    slope = (y[left + 1] - y[left]) / (x[left + 1] - x[left])[:, None]
    return np.asarray(y[left] + slope * (distance_um - x[left])[:, None])


@dataclass(frozen=True)
class RandomContact:
    """Gaussian increments of a law (Eq. 1), with correlated axes and a gain that grows with depth.

    correlation is the (3, 3) matrix of the axes; an increment at depth d is scaled by 1 + depth_gain * d / length.
    """

    law: Law
    length_um: float
    depth_gain: float = 0.0
    correlation: Array = field(default_factory=lambda: np.eye(3))

    def increment_mN(self, before_um: Array, after_um: Array, depth_um: Array, noise: Array) -> Array:
        """Return the force (batch, 3) added while an axial move goes on from before_um to after_um (batch,).

        The stretch begins depth_um (batch,) deep; noise (batch, 3) is standard normal, from each rig's own generator.
        """
        mean = self.law.mean_mN(after_um) - self.law.mean_mN(before_um)
        variance = np.maximum(self.law.variance_mN2(after_um) - self.law.variance_mN2(before_um), 0.0)
        correlated = noise @ np.linalg.cholesky(self.correlation).T
        gain = 1.0 + self.depth_gain * depth_um / self.length_um
        return np.asarray((mean + np.sqrt(variance) * correlated) * gain[:, None])


@dataclass(frozen=True)
class RecordedContact:
    """A recorded insertion replayed: contact force (mN) over depth (um), linear between samples, then constant."""

    depth_um: tuple[float, ...]
    forces_mN: tuple[Vector, ...]

    def increment_mN(self, before_um: Array, after_um: Array, depth_um: Array, noise: Array) -> Array:
        """Return the recorded change of force (batch, 3) over this stretch; noise is not used."""
        return self._force_mN(depth_um + after_um - before_um) - self._force_mN(depth_um)

    def _force_mN(self, depth_um: Array) -> Array:
        forces = np.asarray(self.forces_mN)
        return np.stack([np.interp(depth_um, self.depth_um, forces[:, axis]) for axis in range(3)], axis=1)


Contact = RandomContact | RecordedContact
