"""How Fig. 9 and 10 are shown."""

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from precision_interaction.identification.analysis import BIN_MN, LineFit, gaussian_share, quantile
from precision_interaction.reproduce.contact import CASES, Contact
from precision_interaction.reproduce.pages.page import Page, Picture, Presentation, Table, Wanted
from precision_interaction.reproduce.row import Result, Setting
from precision_interaction.rig.insertion_rig_config import (
    MeasuredContactConfig,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LAWS = ("measured", "proportional")
PAPER = {
    10.0: ((12.7, 20.3), (23.2, 7.0)),
    50.0: ((29.6, 51.7), (56.3, 26.4)),
}
"""What is printed: mean (mN) and variance (mN^2), x and y, by step (um)."""
SHOWN_UM = (10.0, 20.0, 30.0, 40.0, 50.0)
R_SQUARED = 0.96


def present(results: Mapping[str, Result], setting: Setting) -> Presentation:
    """Show the moments, the lines through them with the law that the rig has, and the histograms."""
    wanted = Wanted()
    for name in LAWS:
        found = results[name]
        wanted.at_least(f"{name}: least R^2 of a Gaussian", float(np.min(found["r_squared"])), R_SQUARED)
        wanted.that(f"{name}: the log was taken for the other law", found["chosen"] == name)
    tables = [_moments(results), _recovered(results, wanted), _goodness(results)]
    repetitions = results["measured"]["repetitions"]
    pictures = [
        Picture(
            "fig09",
            f"Fig. 9: mean and variance of the radial force that an insertion adds, {repetitions} of each step, "
            "with 95 % intervals. Above: the rig of the law `measured`; below: `proportional`. Full lines: fitted "
            "with an intercept; dotted lines: through the origin. Crosses: the paper's printed points.",
            _draw_moments(results),
            (7.5, 5.6),
        ),
        Picture(
            "fig10",
            "Fig. 10: how often the force changed by so much, in bins of 7 mN, and what a bin there has of the "
            "Gaussian of the same mean and variance, on the rig of the law `measured`. Above: x; below: y.",
            _draw_histograms(results["measured"]),
            (9.5, 4.2),
        ),
    ]
    words = (
        "The rig inserts by a fixed step, withdraws, and does so again; the log is analysed by the same routine "
        "that reads a real rig's log (`neurorobo identify`). One count of the paper's force sensor, 7.8 mN, is "
        "wider than the deviation to be measured; it *can be improved with filtering*, so that ours is read as if "
        "filtered, and once as it is. That increments of the simulated rig are Gaussian is how the rig is built; "
        "what is tested is that the identification finds the law that is there.",
    )
    return Presentation(words, tables, pictures, wanted.misses)


def _moments(results: Mapping[str, Result]) -> Table:
    """Return mean and variance at the steps that the paper prints, and at the others."""
    lines = []
    for i, step in enumerate(results["measured"]["step_um"]):
        printed = PAPER.get(step)
        paper = " / ".join(_pair(values) for values in printed) if printed else "-"
        ours = [f"{_pair(results[law]['mean_mN'][i])} / {_pair(results[law]['variance_mN2'][i])}" for law in CASES]
        lines.append([f"{step:g}", paper, *ours])
    caption = "Mean in mN / variance in mN^2 of the radial force, x and y, that an insertion of this step adds."
    return Table(["step, um", "paper", *(f"ours, {case}" for case in CASES)], lines, caption)


def _recovered(results: Mapping[str, Result], wanted: Wanted) -> Table:
    """Return what was fitted beside what the rig is built with."""
    lines = []
    for law in LAWS:
        contact = CASES[law][0]
        truths = {"mean slope, mN/um": contact.mean_slope, "variance slope, mN^2/um": contact.variance_slope}
        if isinstance(contact, MeasuredContactConfig):
            truths["mean intercept, mN"] = contact.mean_intercept
            truths["variance intercept, mN^2"] = contact.variance_intercept
        reach = quantile(2 * len(truths))
        for name, truth in truths.items():
            quantity, part, _ = name.replace(",", "").split()
            line = results[law]["fits"][law][quantity]
            for axis in range(2):
                value, error = line[part][axis], reach * line[f"{part}_error"][axis]
                holds = abs(value - truth[axis]) <= error
                wanted.that(f"{law}: the {name} of {'xy'[axis]} is outside the interval of what was fitted", holds)
                lines.append(
                    [law, f"{name}, {'xy'[axis]}", f"{truth[axis]:.4g}", f"{value:.4g} ± {error:.2g}", _yes(holds)]
                )
    caption = (
        "What the rig is built with, and what was fitted to its log; the intervals hold for all figures of a law "
        "together with 95 % confidence (Bonferroni)."
    )
    return Table(("rig", "parameter", "built with", "fitted", "inside"), lines, caption)


def _goodness(results: Mapping[str, Result]) -> Table:
    lines = [[case, "> 0.96", *(f"{np.min(row):.3f}" for row in results[case]["r_squared"])] for case in CASES]
    steps = [f"{step:g} um" for step in results["measured"]["step_um"]]
    return Table(["rig", "paper", *steps], lines, "R^2 of the Gaussian in bins of 7 mN; of x and y the lesser one.")


def _pair(values: Sequence[float]) -> str:
    return ", ".join(f"{value:.1f}" for value in values)


def _yes(holds: bool) -> str:
    return "yes" if holds else "no"


def _draw_moments(results: Mapping[str, Result]) -> Callable[["Figure"], None]:
    def draw(figure: "Figure") -> None:
        panels = figure.subplots(len(LAWS), 2, sharex=True)
        for row, law in zip(panels, LAWS, strict=True):
            found = results[law]
            steps, count = np.asarray(found["step_um"]), found["repetitions"]
            mean, variance = np.asarray(found["mean_mN"]), np.asarray(found["variance_mN2"])
            errors = 1.96 * np.sqrt(variance / count), 1.96 * variance * np.sqrt(2 / (count - 1))
            ends = np.array([0.0, steps[-1]])
            for panel, quantity, values, error in zip(row, ("mean", "variance"), (mean, variance), errors, strict=True):
                for axis, name in enumerate("xy"):
                    colour = f"C{axis}"
                    panel.errorbar(
                        steps, values[:, axis], error[:, axis], fmt="o", ms=3, capsize=2, color=colour, label=name
                    )
                    for fitted, style in (("measured", "-"), ("proportional", ":")):
                        line = LineFit(**{k: np.asarray(v) for k, v in found["fits"][fitted][quantity].items()})
                        panel.plot(ends, line.at(ends)[:, axis], style, color=colour)
                    printed = [PAPER[step][quantity == "variance"][axis] for step in PAPER]
                    panel.plot(list(PAPER), printed, "x", color="black", ms=6)
                panel.set_ylabel(f"{quantity}, {'mN' if quantity == 'mean' else 'mN²'}")
            row[0].set_title(law, loc="left")
        panels[0, 0].legend(loc="upper left")
        for panel in panels[-1]:
            panel.set_xlabel("insertion step, µm")

    return draw


def _draw_histograms(found: Result) -> Callable[["Figure"], None]:
    def draw(figure: "Figure") -> None:
        panels = figure.subplots(2, len(SHOWN_UM), sharex=True, sharey=True)
        for column, step in enumerate(SHOWN_UM):
            for axis in range(2):
                panel, one = panels[axis, column], found["histograms"][found["step_um"].index(step)][axis]
                panel.bar(one["centre_mN"], one["share"], 0.9 * BIN_MN, color=f"C{axis}", alpha=0.55)
                force = np.linspace(one["centre_mN"][0], one["centre_mN"][-1], 100)
                number = found["step_um"].index(step)
                mean, variance = found["mean_mN"][number][axis], found["variance_mN2"][number][axis]
                panel.plot(force, gaussian_share(mean, variance**0.5, force), color="black", lw=1)
                panel.text(0.97, 0.95, f"R² {one['r_squared']:.3f}", transform=panel.transAxes, ha="right", va="top")
            panels[0, column].set_title(f"{step:g} µm")
            panels[1, column].set_xlabel("force change, mN")
        for axis, name in enumerate("xy"):
            panels[axis, 0].set_ylabel(f"{name}: share")

    return draw


PAGE = Page(
    Contact(),
    title="The contact of an insertion, identified",
    paper="Fig. 9-10",
    minutes=0.02,
    present=present,
)
