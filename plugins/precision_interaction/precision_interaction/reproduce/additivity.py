"""Appendix A: that n steps add n times the mean and covariance of one (Eq. 35), where it holds and where it fails."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from precision_interaction.identification.experiment import reach
from precision_interaction.reproduce.row import Picture, Presentation, Result, Row, Setting, Table, Wanted
from precision_interaction.rig.insertion_rig_config import (
    InsertionRigConfig,
    MeasuredContactConfig,
    ProportionalContactConfig,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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
HOLDS = {
    ("proportional", MOVES): True,
    ("proportional", LONGER): True,
    ("proportional", PERIODS): True,
    ("measured", MOVES): True,
    ("measured", LONGER): False,
    ("measured", PERIODS): False,
    ("proportional, growing with depth", MOVES): False,
    ("proportional, growing with depth", LONGER): True,  # a move's gain is that of where it begins
    ("proportional, growing with depth", PERIODS): False,
}
SIGNIFICANCE = 0.05
"""Of all tests together; each is judged at this by their number."""


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
    title: ClassVar[str] = "Several steps add up to several times one"
    paper: ClassVar[str] = "Appendix A, Eq. 35"
    minutes: ClassVar[float] = 0.1

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

    def present(self, results: Mapping[str, Result], setting: Setting) -> Presentation:
        """Show which law adds up in which way, and whether that is as it should be."""
        wanted = Wanted()
        level = SIGNIFICANCE / (len(HOLDS) * (MOST_STEPS - 1))
        lines, tested = [], []
        for law, found in results.items():
            for form in FORMS:
                mean, covariance = (
                    [_ratio(found[form], name, n) for n in range(2, MOST_STEPS + 1)]
                    for name in ("mean_mN", "covariance_mN2")
                )
                least = min(one["p"] for one in found[form][1:])
                adds = least > level
                lines.append([law, form, _range(mean), _range(covariance), _power(least), "yes" if adds else "no"])
                tested += [
                    [law, form, str(n), f"{one['chi2_mean']:.1f}", f"{one['chi2_covariance']:.1f}", _power(one["p"])]
                    for n, one in enumerate(found[form], start=1)
                ]
                wanted.that(f"{law}, {form}: p is {least:.2g}, against what holds", adds == HOLDS[law, form])
        summary = Table(
            ("rig", "n steps are", "mean / n of one", "variance / n of one", "least p", "adds up"),
            lines,
            f"The mean and variance of n = 2..{MOST_STEPS} steps over n times those of one, the least and the largest "
            f"of both axes; {results['measured']['repetitions']} repetitions. Eq. 35 asks for 1. It is given up where "
            f"p is below {level:.1e}, {SIGNIFICANCE:g} by the number of tests.",
        )
        every = Table(
            ("rig", "n steps are", "n", "χ² of the mean (2)", "χ² of the covariance (3)", "p"),
            tested,
            "Hotelling's statistic of the mean and that of the elements of the covariance, with degrees of freedom.",
        )
        words = (
            "Appendix A proves that n steps add n times the mean and covariance of one, and concludes that one step of "
            "twice the speed adds as much as two steps. The first needs no more than increments that are independent "
            "and all alike: moves of the rig add up under either law, and stop adding up only where the contact grows "
            "with depth. The second needs a law without intercept. The paper's own points have one (Fig. 9): on the "
            "rig of the law `measured` a move n times as long adds less than n moves, and so do n periods of a radial "
            "loop that is faster than the axial one.",
        )
        picture = Picture(
            "additivity",
            "Appendix A: mean and variance after n steps over n times those of one; Eq. 35 asks for 1. Above: mean; "
            "below: variance. Full lines: x; dashed: y.",
            _draw(results),
            (8.0, 4.6),
        )
        return Presentation(words, [summary, every], [picture], wanted.misses)


def _ratio(found: Sequence[Mapping[str, Any]], name: str, n: int) -> list[float]:
    """Return what n steps have of a moment over n times what one has, for x and y."""
    place = [0, 1] if name == "mean_mN" else [0, 2]  # of the covariance's elements xx, xy, yy
    return [found[n - 1][name][i] / (n * found[0][name][i]) for i in place]


def _range(ratios: Sequence[Sequence[float]]) -> str:
    return f"{np.min(ratios):.2f} .. {np.max(ratios):.2f}"


def _power(p: float) -> str:
    return f"{p:.2g}" if p >= 1e-4 else "< 1e-4"


def _draw(results: Mapping[str, Result]) -> Callable[["Figure"], None]:
    def draw(figure: "Figure") -> None:
        panels = figure.subplots(2, len(results), sharex=True, sharey=True)
        numbers = range(1, MOST_STEPS + 1)
        for column, (law, found) in enumerate(results.items()):
            for row, name in enumerate(("mean_mN", "covariance_mN2")):
                panel = panels[row, column]
                panel.axhline(1.0, color="black", lw=0.8)
                for colour, form in enumerate(FORMS):
                    for axis, style in enumerate(("-", "--")):
                        ratios = [_ratio(found[form], name, n)[axis] for n in numbers]
                        panel.plot(
                            numbers, ratios, style, marker="o", ms=3, color=f"C{colour}", label=None if axis else form
                        )
            panels[0, column].set_title(law, fontsize=9)
            panels[1, column].set_xlabel("n")
        panels[0, 0].set_ylabel("mean / n of one")
        panels[1, 0].set_ylabel("variance / n of one")
        panels[0, -1].legend(loc="lower left", fontsize=7)

    return draw
