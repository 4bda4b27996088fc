"""How the insertions on MuJoCo's rig are shown."""

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from precision_interaction.identification.analysis import LineFit
from precision_interaction.reproduce.mujoco_rig import IDENTIFICATION, SHIPPED, TEACHERS_RUN, TRAINED, MujocoInsertion
from precision_interaction.reproduce.pages.page import Page, Picture, Presentation, Table, Wanted
from precision_interaction.reproduce.pages.statistics import cell as with_interval
from precision_interaction.reproduce.row import Result, Setting

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_OF_TEACHERS = 1.3
STIFFNESS_MN_UM = 80.0
CONTROLLERS = {
    TEACHERS_RUN: "teachers, with the law that was identified",
    SHIPPED: "the brain as it is shipped, taught the paper's law",
    TRAINED: "the brain, its hippocampus taught the law that was identified",
}

WORDS = (
    "The body `precision.mujoco_rig` is a peg on a compliant tool and a hole of layered compliant rings, whose "
    "contacts MuJoCo solves. No force is drawn from a law: it grows as the hole is tilted and its rings lie unevenly. "
    "The law of its contact is identified as on a rig that one cannot look into, and the hippocampus is trained on "
    "what was found. The experiment differs from that of the paper's rig in its `body` block alone; cerebellum and "
    "prefrontal cortex are the shipped ones.",
)


def present(results: Mapping[str, Result], setting: Setting) -> Presentation:
    """Show what was identified, and the insertions."""
    wanted = Wanted()
    found = results[IDENTIFICATION]
    wanted.that("the contact in the example's file is not what is identified", found["contact"] == found["in_the_file"])
    brain, teachers = results[TRAINED], results[TEACHERS_RUN]
    inserted = sum(success == 1.0 for success in brain["success"])
    wanted.that("the trained brain does not insert with every seed", inserted == len(brain["success"]))
    wanted.at_most("the trained brain's largest final error, um", max(brain["final_error_um"]), 1.0)
    share = float(np.mean(brain["mean_force_mN"]) / np.mean(teachers["mean_force_mN"]))
    wanted.at_most("the trained brain's mean force, as a share of the teachers'", share, MOST_OF_TEACHERS)
    picture = Picture(
        "mujoco",
        "Mean and variance of the radial force that an insertion adds on MuJoCo's rig, with 95 % intervals. Full "
        "lines: fitted with an intercept; dotted lines: through the origin.",
        _drawing(found),
        (7.5, 3.0),
    )
    return Presentation(WORDS, [_moments(found), _insertions(results)], [picture], wanted.misses)


def _moments(found: Result) -> Table:
    lines = []
    for i, step in enumerate(found["step_um"]):
        columns = ((found["mean_mN"], 2), (found["variance_mN2"], 2), (found["r_squared"], 3))
        lines.append([f"{step:g}", *(_pair(values[i], digits) for values, digits in columns)])
    fit = found["fits"]["proportional"]
    slopes = {name: _pair(fit[name]["slope"], 3) for name in ("mean", "variance")}
    explained = {name: _pair(found["line_r_squared"][name], 3) for name in ("mean", "variance")}
    stiffness = found["stiffness_mN_um"]
    felt = " and ".join(
        f"{mean:.1f} ± {deviation:.1f}"
        for mean, deviation in zip(stiffness["mean"], stiffness["deviation"], strict=True)
    )
    caption = (
        f"{found['repetitions']} insertions of each step; x and y. The last column is the R^2 of a Gaussian in bins of "
        f"7 mN. Lines through the origin have the slopes {slopes['mean']} mN/um of the mean (R^2 {explained['mean']}) "
        f"and {slopes['variance']} mN^2/um of the variance (R^2 {explained['variance']}); `auto` chose the law "
        f"`{found['contact']['law']}`. A radial move takes off {felt} mN/um (mean and deviation over the holes), where "
        f"the brain counts on {STIFFNESS_MN_UM:g}."
    )
    return Table(("step, um", "mean, mN", "variance, mN^2", "R^2"), lines, caption)


def _pair(values: Sequence[float], digits: int) -> str:
    return ", ".join(f"{value:.{digits}f}" for value in values[:2])


def _insertions(results: Mapping[str, Result]) -> Table:
    teachers = float(np.mean(results[TEACHERS_RUN]["mean_force_mN"]))
    lines = []
    for name, words in CONTROLLERS.items():
        found = results[name]
        figures = [with_interval(found[metric]) for metric in ("steps", "mean_force_mN", "max_force_mN")]
        inserted = sum(success == 1.0 for success in found["success"])
        worst = f"{max(found['mean_force_mN']):.1f} / {max(found['max_force_mN']):.1f}"
        share = f"{float(np.mean(found['mean_force_mN'])) / teachers:.2f}"
        lines.append([words, *figures, worst, share, f"{inserted} of {len(found['success'])}"])
    caption = "Means over the runs, with 95 % intervals from a bootstrap, and the worst run."
    heads = (
        "controller",
        "steps",
        "mean force, mN",
        "largest force, mN",
        "worst mean / largest",
        "mean force, of the teachers'",
        "inserted",
    )
    return Table(heads, lines, caption)


def _drawing(found: Result) -> Callable[["Figure"], None]:
    def draw(figure: "Figure") -> None:
        steps, count = np.asarray(found["step_um"]), found["repetitions"]
        mean, variance = (np.asarray(found[name])[:, :2] for name in ("mean_mN", "variance_mN2"))
        errors = 1.96 * np.sqrt(variance / count), 1.96 * variance * np.sqrt(2 / (count - 1))
        ends = np.array([0.0, steps[-1]])
        panels = figure.subplots(1, 2)
        for panel, quantity, values, error in zip(panels, ("mean", "variance"), (mean, variance), errors, strict=True):
            for axis, name in enumerate("xy"):
                colour = f"C{axis}"
                panel.errorbar(
                    steps, values[:, axis], error[:, axis], fmt="o", ms=3, capsize=2, color=colour, label=name
                )
                for law, style in (("measured", "-"), ("proportional", ":")):
                    line = LineFit(**{key: np.asarray(value) for key, value in found["fits"][law][quantity].items()})
                    panel.plot(ends, line.at(ends)[:, axis], style, color=colour)
            unit = "mN" if quantity == "mean" else "mN²"
            panel.set(xlabel="insertion step, µm", ylabel=f"{quantity}, {unit}")
        panels[0].legend(loc="upper left")

    return draw


PAGE = Page(
    MujocoInsertion(),
    title="A rig whose contact MuJoCo solves",
    paper="Beyond the paper",
    minutes=1.6,
    package="mujoco",
    present=present,
)
