"""Appendix A: that n steps add n times the mean and covariance of one (Eq. 35), where it holds and where it fails."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from precision_interaction.identification.experiment import reach
from precision_interaction.reproduce.row import Result, Row, Setting
from precision_interaction.rig.insertion_rig_config import (
    InsertionRigConfig,
    MeasuredContactConfig,
    ProportionalContactConfig,
)

if TYPE_CHECKING:
    pass

Array = NDArray[np.float64]

STEP_UM = 20.0
MOST_STEPS = 5
REPETITIONS, QUICK_REPETITIONS = 10_000, 100
LAWS = {
    "proportional": ProportionalContactConfig(law="proportional"),
    "measured": MeasuredContactConfig(),
    "proportional, growing with depth": ProportionalContactConfig(law="proportional", depth_gain=1.0),
}
MOVES = "n moves of 20 um"
LONGER = "one move of n x 20 um"
PERIODS = "n periods of 20 um within a move"
FORMS = (MOVES, LONGER, PERIODS)


@dataclass(frozen=True)
class Test:
    """How far n steps are from n times one: chi-squared of the mean (2 degrees of freedom) and covariance (3)."""

    mean: float
    covariance: float

    @property
    def p(self) -> float:
        """The probability of so large a difference by chance; of the two tests the lesser one, twice (Bonferroni)."""
        of_mean = math.exp(-self.mean / 2)
        half = self.covariance / 2
        of_covariance = math.erfc(math.sqrt(half)) + 2 * math.sqrt(half / math.pi) * math.exp(-half)
        return min(1.0, 2 * min(of_mean, of_covariance))


def compare(one: Array, several: Array, steps: int) -> Test:
    """Test whether ``several`` (n, 2) has ``steps`` times the mean and covariance of ``one`` (m, 2), independent of it.

    Hotelling's statistic of the means; of the covariance that of its three elements, whose own covariance is that of
    Gaussian samples. Both are chi-squared for large samples, if Eq. 35 holds.
    """
    covariance, covariance_one = np.cov(several.T), np.cov(one.T)
    of_mean = several.mean(0) - steps * one.mean(0)
    error_of_mean = covariance / len(several) + steps**2 * covariance_one / len(one)
    elements = np.triu_indices(2)
    of_covariance = (covariance - steps * covariance_one)[elements]
    error = _covariance_of(covariance, len(several)) + steps**2 * _covariance_of(covariance_one, len(one))
    return Test(
        float(of_mean @ np.linalg.solve(error_of_mean, of_mean)),
        float(of_covariance @ np.linalg.solve(error, of_covariance)),
    )


def _covariance_of(s: Array, count: int) -> Array:
    """Return the covariance (3, 3) of the elements xx, xy, yy of a Gaussian's sample covariance ``s`` (2, 2)."""
    pairs = list(zip(*np.triu_indices(2), strict=True))
    return np.array([[s[i, k] * s[j, m] + s[i, m] * s[j, k] for k, m in pairs] for i, j in pairs]) / (count - 1)


class Additivity(Row):
    """Means and covariances over several steps."""

    name: ClassVar[str] = "additivity"

    def cells(self, setting: Setting) -> Sequence[str]:
        """Return the laws."""
        return list(LAWS)

    def measure(self, cell: str, setting: Setting) -> Result:
        """Insert from the same depth on, by every way of making n steps, each with rigs of its own."""
        repetitions = QUICK_REPETITIONS if setting.quick else REPETITIONS
        rig = InsertionRigConfig(contact=LAWS[cell]).model_copy(update={"gap": 0.0, "force_resolution": 0.0})
        law = list(LAWS).index(cell)
        one = reach(rig, [STEP_UM], repetitions, (law, 0))[-1]
        first = reach(rig, [MOST_STEPS * STEP_UM], repetitions, (law, 1), parts=MOST_STEPS)[1]
        within = reach(rig, [MOST_STEPS * STEP_UM], repetitions, (law, 2), parts=MOST_STEPS)
        found: dict[str, list[dict[str, Any]]] = {form: [] for form in FORMS}
        for n in range(1, MOST_STEPS + 1):
            ways = {
                MOVES: reach(rig, [STEP_UM] * n, repetitions, (law, 3, n))[-1],
                LONGER: reach(rig, [n * STEP_UM], repetitions, (law, 4, n))[-1],
                PERIODS: within[n],
            }
            for form, force in ways.items():
                test = compare(first if form == PERIODS else one, force, n)
                found[form].append(
                    {
                        "mean_mN": force.mean(0).tolist(),
                        "covariance_mN2": np.cov(force.T)[np.triu_indices(2)].tolist(),
                        "chi2_mean": test.mean,
                        "chi2_covariance": test.covariance,
                        "p": test.p,
                    }
                )
        return {"repetitions": repetitions, **found}
