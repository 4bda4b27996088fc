"""How Fig. 6 is shown."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from precision_interaction import table_one
from precision_interaction.baselines.pid_tuning import (
    TEST_PERIODS,
)
from precision_interaction.reproduce.cerebellum import (
    PAPER_PERIOD_S,
    TEACHERS,
    Cerebellum,
    networks,
    others_cell,
    periods,
)
from precision_interaction.reproduce.compensation import (
    Network,
)
from precision_interaction.reproduce.pages.page import Page, Picture, Presentation, Table, Wanted
from precision_interaction.reproduce.pages.statistics import cell as with_interval
from precision_interaction.reproduce.pages.statistics import interval
from precision_interaction.reproduce.row import Result, Setting

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PAPER_NETWORK_MN, PAPER_PID_MN = 76.0, 88.0
WANTED_SHARE, WANTED_MN = 0.15, 2.0
"""How far a network may be from its teacher, as a share or in mN, whichever is more."""
LABELS = {
    "profile teacher": "profile, teacher",
    "profile network": "profile, network",
    "predictive teacher": "predictive, teacher",
    "predictive network": "predictive, network",
    "Ziegler-Nichols": "PID, Ziegler-Nichols",
    "grid search": "PID, best of the grid",
}
PAPER = {"profile network": PAPER_NETWORK_MN, "Ziegler-Nichols": PAPER_PID_MN}
Found = Mapping[str, Result]
"""What was found in one control period, by the keys of `LABELS`."""


def present(results: Mapping[str, Result], setting: Setting) -> Presentation:
    """Show forces by period and by number of nuclei, gains, and the paper's picture."""
    found = {period_s: _of_period(results, period_s) for period_s in periods(setting)}
    tables = [_table_of_periods(found), _table_of_nuclei(results, setting), _table_of_gains(results, setting)]
    words = [*_words(found), *_spread(results, setting)]
    return Presentation(words, tables, [_picture(found)], _missed(found))


def _spread(results: Mapping[str, Result], setting: Setting) -> Sequence[str]:
    """Say how far trainings from other seeds differ, where there are several."""
    told = []
    for teacher in TEACHERS:
        size = Network(teacher, PAPER_PERIOD_S)
        seeded = {n.seed: results[n.name] for n in networks(setting) if replace(n, seed=size.seed) == size}
        forces = ", ".join(f"{_mean(result):.1f}" for result in seeded.values())
        if len(seeded) > 1:
            told.append(f"{forces} mN of `{teacher}` from seeds {', '.join(map(str, seeded))}")
    return [f"Trainings of the paper's size at {PAPER_PERIOD_S:g} s differ by seed: {'; '.join(told)}."] if told else []


def _of_period(results: Mapping[str, Result], period_s: float) -> Found:
    others = results[others_cell(period_s)]
    ours = {f"{teacher} network": results[Network(teacher, period_s).name] for teacher in TEACHERS}
    return {name: ours[name] if name in ours else others[name] for name in LABELS}


def _mean(result: Result) -> float:
    return float(np.mean(result["mean_mN"]))


def _lead(found: Found, name: str) -> list[float]:
    """Return how far a controller is below the best PID, mN, trajectory by trajectory."""
    return list(np.subtract(found["grid search"]["mean_mN"], found[name]["mean_mN"]))


def _table_of_periods(found: Mapping[float, Found]) -> Table:
    lines = []
    for name, label in LABELS.items():
        paper = f"{PAPER[name]:g}" if name in PAPER else "-"
        lines.append([label, paper, *(with_interval(f[name]["mean_mN"]) for f in found.values())])
    held = (with_interval(f["predictive network"]["held_mean_mN"]) for f in found.values())
    lines.append(["predictive, network, held", "-", *held])
    for name in ("predictive teacher", "predictive network"):
        label = f"best PID less {LABELS[name]}"
        lines.append([label, "-", *(with_interval(_lead(f, name), digits=2) for f in found.values())])
    caption = (
        f"Mean norm of the radial force in mN over the first {TEST_PERIODS} periods, by the length of the control "
        "period, with 95 % intervals from a bootstrap over the trajectories; those of differences are of pairs that "
        "meet the same draws. The networks have 8 deep nuclei, and are of one training each, of seed 1. Held: "
        "the network gets no more acceleration of the stage than a PID controller does. `profile` is left "
        "as its teacher is, whose path may start at any velocity."
    )
    return Table(("controller", "paper", *(f"{period_s:g} s" for period_s in found)), lines, caption)


def _table_of_nuclei(results: Mapping[str, Result], setting: Setting) -> Table:
    counts = sorted({network.nuclei for network in networks(setting)})
    lines = []
    for nuclei in counts:
        line = [str(nuclei)]
        for teacher in TEACHERS:
            result = results[Network(teacher, PAPER_PERIOD_S, nuclei).name]
            errors = f"{result['move_error_mN']:.1f}", f"{result['residual_error_mN']:.1f}"
            line.append(with_interval(result["mean_mN"]))
            if teacher == "predictive":
                line.append(with_interval(result["held_mean_mN"]))
            line += errors
        lines.append(line)
    heads = ["deep nuclei"]
    for teacher in TEACHERS:
        heads += [f"{teacher}: force", *(["force, held"] if teacher == "predictive" else [])]
        heads += ["error of the move", "error of the forecast"]
    caption = (
        f"The same by the number of deep nuclei, at {PAPER_PERIOD_S:g} s, in mN. Errors are rms differences from the "
        "teacher per axis, on what the network meets in the test: that of the move in the force which it takes off, "
        "and that of the force which it says will be left. One training each, of seed 1; held as above."
    )
    return Table(heads, lines, caption)


def _table_of_gains(results: Mapping[str, Result], setting: Setting) -> Table:
    lines = []
    for period_s in periods(setting):
        found = results[others_cell(period_s)]
        gains = [
            " / ".join(f"{gain:.2f}" for gain in found["gains"][name]) for name in ("Ziegler-Nichols", "grid search")
        ]
        lines.append(
            [f"{period_s:g} s", f"{found['ultimate']['gain']:.2f}", f"{found['ultimate']['period_s']:g} s", *gains]
        )
    heads = ("control period", "ultimate gain", "its period", "Ziegler-Nichols", "best of the grid")
    return Table(
        heads, lines, "Gains kp / ki / kd per control period, as shares of the move that would take all force off."
    )


def _words(found: Mapping[float, Found]) -> Sequence[str]:
    limit = table_one.MAX_ACCELERATION_UM_S2 / 2**0.5
    asked = ", ".join(
        f"{f['predictive network']['acceleration_um_s2']:.1f} at {period_s:g} s" for period_s, f in found.items()
    )
    paper = {name: _mean(result) for name, result in found[PAPER_PERIOD_S].items()}
    beaten = [period_s for period_s, f in found.items() if _mean(f["grid search"]) < _mean(f["profile teacher"])]
    return (
        "On each axis the force starts at 64 to 80 mN and the radial velocity at -2 to 0 µm/s, which makes the force "
        "grow at first; the axial speed is 30 µm/s, and each period adds a contact that is drawn from the trained law. "
        "All controllers meet the same draws.",
        "A cerebellum's codes and weights are those of one control period, so that one network is trained for each, by "
        "`supervise`, half on states that it meets by itself in this test and half on `precision.compensation_states`. "
        "Its codes span what its teacher does here. Codes, weights and the gains of the grid are all chosen on other "
        "draws than those of the test.",
        "The paper tells neither its control period nor the form of its PID. At "
        f"{PAPER_PERIOD_S:g} s its own compensator (`profile`, Eq. 14-19) gives {paper['profile teacher']:.0f} mN, and "
        f"it prints {PAPER_NETWORK_MN:g} for its network; the rule of Ziegler and Nichols gives "
        f"{paper['Ziegler-Nichols']:.0f} mN, and it prints {PAPER_PID_MN:g}. The rule is made for plants with a lag: "
        "this one has none but the limit of acceleration, its ultimate gain is 2 wherever that limit is out of reach, "
        "and the gains of the rule add up to more, so that the loop swings. The best gains of a grid are the stronger "
        f"opponent; they beat the paper's compensator at {len(beaten)} of {len(found)} periods.",
        "`predictive` moves to zero force within the stage's acceleration and brakes in time. Teachers and PIDs keep "
        f"the limit of {limit:.1f} µm/s² per axis, with the exception of `profile`, whose path may start at another "
        "velocity than the stage has; networks are held to it only where the tables say so. In 5 % of the periods the "
        f"`predictive` network asks for more than this (µm/s²): {asked}.",
    )


def _missed(found: Mapping[float, Found]) -> Sequence[str]:
    wanted = Wanted()
    for period_s, f in found.items():
        ahead_mN = float(np.mean(_lead(f, "predictive teacher")))
        wanted.that(f"the predictive teacher is not ahead of the best PID at {period_s:g} s", ahead_mN > 0)
        if period_s < PAPER_PERIOD_S:
            continue
        for name in TEACHERS:
            theirs = _mean(f[f"{name} teacher"])
            most = max(WANTED_SHARE * theirs, WANTED_MN)
            distance = abs(_mean(f[f"{name} network"]) - theirs)
            wanted.at_most(f"the {name} network's distance from its teacher at {period_s:g} s, mN,", distance, most)
    ours = found[PAPER_PERIOD_S]["predictive network"]
    for key, how in (("mean_mN", ""), ("held_mean_mN", ", held,")):
        what = f"the force of the predictive network{how} at {PAPER_PERIOD_S:g} s, mN,"
        wanted.at_most(what, float(np.mean(ours[key])), PAPER_NETWORK_MN / 5)
    return wanted.misses


def _picture(found: Mapping[float, Found]) -> Picture:
    caption = (
        f"Fig. 6. (a) Radial force of each trajectory at {PAPER_PERIOD_S:g} s, and their mean: as in the paper, the "
        "network that learned the paper's compensator and the PID by the rule of Ziegler and Nichols; then the network "
        f"that learned `predictive` and the best PID of the grid. (b) Mean of the first {TEST_PERIODS} periods by the "
        "length of the period; the crosses are the paper's network and PID, at the period of (a). Networks are of "
        "one training each, of seed 1."
    )
    return Picture("fig6", caption, _drawing(found), (11.0, 3.4))


def _drawing(found: Mapping[float, Found]) -> Callable[["Figure"], None]:
    """Return what draws the courses of two pairs of controllers, and all means."""
    colours = dict(
        zip(("profile", "Ziegler-Nichols", "predictive", "grid search"), ("C0", "C1", "C2", "C3"), strict=True)
    )

    def courses(panel: "Axes", names: Sequence[str]) -> None:
        for place, name in enumerate(names):
            course = np.asarray(found[PAPER_PERIOD_S][name]["course_mN"])
            colour = colours[name.removesuffix(" network")]
            period = np.arange(1, len(course) + 1)
            panel.plot(period, course, color=colour, alpha=0.12, linewidth=0.6, rasterized=True)
            panel.plot(period, course.mean(1), color=colour, linewidth=2, zorder=4 - place, label=LABELS[name])
        panel.set(xlabel="period", yscale="log", ylim=(0.5, 600))
        panel.legend(loc="upper right")

    def draw(figure: "Figure") -> None:
        profile, ours, means = figure.subplots(1, 3)
        courses(profile, ("profile network", "Ziegler-Nichols"))
        courses(ours, ("predictive network", "grid search"))
        profile.set(ylabel="radial force, mN", title="(a)")
        lengths = list(found)
        for name, label in LABELS.items():
            kind = name.removesuffix(" network").removesuffix(" teacher")
            mean, low, high = np.transpose([interval(found[period_s][name]["mean_mN"]) for period_s in lengths])
            line = "--" if name.endswith("teacher") else "-"
            spread = np.nan_to_num([mean - low, high - mean])
            means.errorbar(lengths, mean, spread, fmt="o" + line, markersize=3, color=colours[kind], label=label)
        for name, figure_mN in PAPER.items():
            kind = name.removesuffix(" network")
            means.plot(PAPER_PERIOD_S, figure_mN, "x", color=colours[kind], markersize=8, markeredgewidth=2)
        means.set(xscale="log", yscale="log", xlabel="control period, s", ylabel="mean force, mN", title="(b)")
        means.set_xticks(lengths, [f"{period_s:g}" for period_s in lengths])
        means.minorticks_off()
        means.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8)

    return draw


PAGE = Page(
    Cerebellum(),
    title="The cerebellum and PID controllers compensate a radial force",
    paper="Fig. 6",
    minutes=33,
    present=present,
)
