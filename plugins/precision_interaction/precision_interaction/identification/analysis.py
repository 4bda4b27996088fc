"""What a log of insertions says of the contact: moments, lines through them, and how Gaussian it is (Fig. 9-10)."""

from dataclasses import dataclass
from statistics import NormalDist
from typing import Literal

import numpy as np

from neurorobo.errors import NeuroroboError
from precision_interaction.identification.log import Array, ContactLog

LawName = Literal["measured", "proportional"]

BIN_MN = 7.0
CONFIDENCE = 0.95


@dataclass(frozen=True)
class LineFit:
    """Per axis: value = intercept + slope * step, with the standard errors of both; a fixed intercept is 0 +- 0.

    In mN and mN/um for a mean, mN^2 and mN^2/um for a variance; arrays (axes,).
    """

    intercept: Array
    slope: Array
    intercept_error: Array
    slope_error: Array

    def at(self, step_um: Array) -> Array:
        """Return the line's values (steps, axes)."""
        return self.intercept + self.slope * np.asarray(step_um)[:, None]


@dataclass(frozen=True)
class ContactFit:
    """A contact law as lines: of the mean, and of the variance."""

    law: LawName
    mean: LineFit
    variance: LineFit


@dataclass(frozen=True)
class Histogram:
    """The shares of the increments of one step and axis in bins of ``BIN_MN``, and those of the fitted Gaussian.

    ``centre_mN``, ``share`` and ``gaussian`` (bins,). The Gaussian has the mean and variance of the increments and is
    integrated over each bin, as bins may be wider than it; ``r_squared`` is the share of the variation that it leaves
    nothing of (1 for a perfect fit).
    """

    centre_mN: Array
    share: Array
    gaussian: Array
    r_squared: float


@dataclass(frozen=True)
class Analysis:
    """Of each step (steps,) and axis: repetitions, mean (mN) and variance (mN^2) of the increments, (steps, axes).

    ``correlation_xy`` is that of the radial axes, over all steps; ``count_mN`` the least difference of two radial
    increments; ``histograms`` are one for each step and axis.
    """

    step_um: Array
    repetitions: Array
    mean_mN: Array
    variance_mN2: Array
    correlation_xy: float
    count_mN: float
    measured: ContactFit | None
    proportional: ContactFit
    histograms: tuple[tuple[Histogram, ...], ...]

    @property
    def radial_r_squared(self) -> Array:
        """How well Gaussians fit x and y, (steps, 2)."""
        return np.array([[histogram.r_squared for histogram in of_step[:2]] for of_step in self.histograms])

    @property
    def coarse(self) -> bool:
        """Whether the log is too coarse for what it measures: its counts are wider than the least deviation."""
        return self.count_mN > float(np.sqrt(self.variance_mN2[:, :2].min()))

    @property
    def correlated(self) -> bool:
        """Whether x and y are correlated beyond doubt."""
        return bool(abs(self.correlation_xy) > quantile(1) / np.sqrt(self.repetitions.sum()))

    def best(self) -> ContactFit:
        """Return `measured` if any of its intercepts differs from 0 beyond doubt, else `proportional`."""
        if self.measured is None:
            return self.proportional
        lines = (self.measured.mean, self.measured.variance)
        beyond = quantile(2 * self.mean_mN.shape[1])
        doubted = all((np.abs(line.intercept) <= beyond * line.intercept_error).all() for line in lines)
        return self.proportional if doubted else self.measured


def quantile(of_so_many: int) -> float:
    """Return how many standard errors an interval reaches that holds for all of so many figures (Bonferroni)."""
    return NormalDist().inv_cdf(1 - (1 - CONFIDENCE) / (2 * of_so_many))


def analyse(log: ContactLog) -> Analysis:
    """Return what a log says; a NeuroroboError if the radial force never varies.

    Lines are least squares, each step counting the same: also where a line through the origin is not what the contact
    does, it then is right for the long steps. A mean of n increments is known to sqrt(variance / n), a variance to
    variance * sqrt(2 / (n - 1)), and from these follow the errors of a line. With one step there is no `measured` fit.
    """
    steps = log.steps_um
    samples = [log.of(step) for step in steps]
    repetitions = np.array([len(sample) for sample in samples], dtype=np.float64)
    mean = np.array([sample.mean(0) for sample in samples])
    variance = np.array([sample.var(0, ddof=1) for sample in samples])
    for axis, name in enumerate("xy"):
        if not variance[:, axis].any():
            raise NeuroroboError(
                f"{log.source}: increment_{name}_mN never varies within a step; filter the sensor so that it resolves "
                "the spread of the contact"
            )
    deviation = np.concatenate([sample[:, :2] - sample[:, :2].mean(0) for sample in samples])
    spread = np.repeat(np.sqrt(variance[:, :2]), repetitions.astype(int), axis=0)
    varying = (variance[:, :2] > 0).all(1)  # a step at which an axis never varies tells nothing of the correlation
    both, degrees = np.repeat(varying, repetitions.astype(int)), (repetitions - 1)[varying].sum()
    correlation = float((deviation[both] / spread[both]).prod(1).sum() / max(degrees, 1))
    errors = np.sqrt(variance / repetitions[:, None]), variance * np.sqrt(2 / (repetitions - 1))[:, None]
    measured = _fit("measured", steps, (mean, variance), errors) if len(steps) > 1 else None
    proportional = _fit("proportional", steps, (mean, variance), errors)
    histograms = tuple(tuple(histogram(of_axis) for of_axis in sample.T) for sample in samples)
    count_mN = float(np.diff(np.unique(log.increment_mN[:, :2].round(6))).min())
    return Analysis(steps, repetitions, mean, variance, correlation, count_mN, measured, proportional, histograms)


def _fit(law: LawName, steps: Array, moments: tuple[Array, Array], errors: tuple[Array, Array]) -> ContactFit:
    mean, variance = (
        LineFit(*np.array([_line(steps, y, e, law == "measured", positive) for y, e in zip(ys.T, es.T, strict=True)]).T)
        for ys, es, positive in zip(moments, errors, (False, True), strict=True)
    )
    return ContactFit(law, mean, variance)


def _line(x: Array, y: Array, error: Array, with_intercept: bool, positive: bool) -> tuple[float, float, float, float]:
    """Return intercept, slope and the errors of both; ``positive`` allows no falling line and none that starts below 0.

    Where it is one of those, the nearest line that is neither is returned, with the intercept's error of the first.
    """
    terms = np.stack([np.full_like(x, with_intercept), x], axis=1)
    solution = np.linalg.pinv(terms)
    intercept, slope = solution @ y
    intercept_error, slope_error = np.sqrt(solution**2 @ error**2)
    if positive and slope < 0:
        intercept, slope = y.mean(), 0.0
    if positive and intercept < 0:
        _, slope, _, slope_error = _line(x, y, error, False, False)
        intercept = 0.0
    return float(intercept), float(slope), float(intercept_error), float(slope_error)


def histogram(increment_mN: Array) -> Histogram:
    """Count increments (n,) in bins of ``BIN_MN``, one of them around their mean, and compare with a Gaussian."""
    mean, deviation = float(increment_mN.mean()), float(increment_mN.std(ddof=1))
    bins = np.floor((increment_mN - mean) / BIN_MN + 0.5).astype(int)
    numbers = np.arange(bins.min() - 1, bins.max() + 2)  # an empty bin at each end belongs to the picture
    share = np.array([(bins == number).mean() for number in numbers])
    centre = mean + numbers * BIN_MN
    if deviation == 0:
        return Histogram(centre, share, share, 1.0)
    gaussian = gaussian_share(mean, deviation, centre)
    missed = ((share - gaussian) ** 2).sum()
    return Histogram(centre, share, gaussian, float(1 - missed / ((share - share.mean()) ** 2).sum()))


def gaussian_share(mean_mN: float, deviation_mN: float, centre_mN: Array) -> Array:
    """Return what a Gaussian has in bins of ``BIN_MN`` around these centres (n,)."""
    normal = NormalDist(mean_mN, deviation_mN)
    return np.array([normal.cdf(at + BIN_MN / 2) - normal.cdf(at - BIN_MN / 2) for at in centre_mN])
