"""How Appendix A is shown."""

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from precision_interaction.reproduce.additivity import FORMS, LONGER, MOST_STEPS, MOVES, PERIODS, Additivity
from precision_interaction.reproduce.pages.page import Page, Picture, Presentation, Table, Wanted
from precision_interaction.reproduce.row import Result, Setting

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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


def present(results: Mapping[str, Result], setting: Setting) -> Presentation:
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


PAGE = Page(
    Additivity(),
    title="Several steps add up to several times one",
    paper="Appendix A, Eq. 35",
    minutes=0.1,
    present=present,
)
