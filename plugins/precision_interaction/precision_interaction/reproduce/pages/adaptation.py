"""How adaptation is shown."""

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from precision_interaction.reproduce.adaptation import PERIODS_BEFORE, SESSIONS, TIMED, Adaptation
from precision_interaction.reproduce.pages.page import Page, Picture, Presentation, Table, Wanted
from precision_interaction.reproduce.pages.statistics import cell as with_interval
from precision_interaction.reproduce.pages.statistics import quotient
from precision_interaction.reproduce.row import Result, Setting

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LEARNING, SHIPPED, TAUGHT = (f"paper rig, {what}" for what in ("learning", "as shipped", "trained on its law"))
CHANGED = {
    "fine rig, learning": "learning",
    "fine rig, as shipped": "as shipped",
    "fine rig, ideal": "ideal, not told",
}
TOLD = "fine rig, ideal, told"
MOST_OF_TRAINED, MOST_OF_FORMER, WITHIN_PERIODS, PERIOD_MS = 1.1, 1.2, 5, 50.0

WORDS = (
    "Each session is a brain of its own that inserts several times in a row: what it learns in one insertion, it knows "
    "in the next. *Paper rig*: `peg_in_hole_adaptive.yaml` starts with the proportional law on a rig of the measured "
    "one, and its hippocampus learns. *Fine rig*: in `peg_in_hole_fast_adaptive.yaml` hippocampus and cerebellum learn "
    "at 20 Hz, and in the first insertion the stiffness rises from 80 to 120 mN/µm at a travel of 1 mm.",
)


def present(results: Mapping[str, Result], setting: Setting) -> Presentation:
    """Show forces by insertion and around the change, and what is forgotten."""
    wanted = Wanted()
    (first, *_, last), (trained,) = results[LEARNING]["stretches"][0], results[TAUGHT]["stretches"][0]
    (plain,) = results[SHIPPED]["stretches"][0]
    share = _mean(last) / _mean(trained)
    wanted.at_most("force of the last insertion, of what training on the rig's law gives", share, MOST_OF_TRAINED)
    for name in SESSIONS:
        for number, insertion in enumerate(_insertions(results[name]), start=1):
            wanted.that(f"{name}: insertion {number} failed", all(insertion["success"]))
    ratios = {name: _ratios(results[name]["around"]) for name in CHANGED}
    fifth = ratios["fine rig, learning"][PERIODS_BEFORE + WITHIN_PERIODS - 1]
    wanted.at_most("force in the fifth period after the change, of the former", float(fifth), MOST_OF_FORMER)
    for example, found in results["learning off"].items():
        wanted.that(f"{example}: learning that is switched off changes something", found["same"] == found["of"])
    period = results["control period"]["learning"]
    wanted.at_most("ms of a radial period that plans", period["planning"], PERIOD_MS)
    off = ", ".join(f"{found['same']} of {found['of']} with {name}" for name, found in results["learning off"].items())
    before, plain_before = (_before(results[f"fine rig, {how}"]) for how in ("learning", "as shipped"))
    words = (
        *WORDS,
        f"Learning, the first insertion takes {_force(first)} mN and the last one {_force(last)}: the gain is there "
        f"within the first insertion. The brain as shipped takes {_force(plain)} on the seeds of the last one; on "
        "those of the first, which are the seeds of Table I, it takes what stands there (`brain, paper rig`): another "
        "mean of the same brain, by other seeds alone.",
        f"The last of the insertions takes {share:.2f} times the force that the same brain takes with a hippocampus "
        "that was trained on the rig's law.",
        f"With learning switched off, every force and every travel is the same, to the last bit, as those of the plain "
        f"example: in {off}.",
        "On the fine rig the force in the fifth second after the change is "
        f"{_quotient(_fifth(results['fine rig, learning']), before)} times the former with learning, and "
        f"{_quotient(_fifth(results['fine rig, as shipped']), plain_before)} times as shipped; before the change, "
        f"learning takes {_quotient(before, plain_before)} times the force of the brain as shipped. Brackets are 95 % "
        "intervals from a bootstrap over the sessions, in pairs.",
    )
    pictures = [
        Picture(
            "adaptation_law",
            "Mean force by insertion on the paper rig, with the 95 % interval of the mean over the sessions. What "
            "there is to gain is gained within the first. Dashed: brains that do not learn, on the seeds of the last.",
            _drawing_of_insertions(results),
        ),
        Picture(
            "adaptation_stiffness",
            "Mean force in each second around the change of the stiffness, as a share of the mean of the five before "
            "it; bands are 95 % intervals of the mean. Dotted: what is wanted.",
            _drawing_of_change(results),
        ),
    ]
    return Presentation(words, [_law(results), _change(results, ratios), _times(results)], pictures, wanted.misses)


def _law(results: Mapping[str, Result]) -> Table:
    (plain,), plain_prior = results[SHIPPED]["stretches"]
    (taught,) = results[TAUGHT]["stretches"][0]
    measured, prior, again = results[LEARNING]["stretches"]
    beside = [("-", "-")] * (len(measured) - 1) + [(_force(plain), _force(taught))]
    lines = [
        [f"{i}", _force(found), *others] for i, (found, others) in enumerate(zip(measured, beside, strict=True), 1)
    ]
    for i, (found, other) in enumerate(zip(prior, plain_prior, strict=True), len(lines) + 1):
        lines.append([f"{i}, on a rig of the proportional law", _force(found), _force(other), "-"])
    lines += [[f"{i}, back again", _force(found), "-", "-"] for i, found in enumerate(again, len(lines) + 1)]
    return Table(
        ("insertion", "learning", "as shipped", "trained on the rig's law"),
        lines,
        "Mean force in mN on the paper rig, and what is forgotten.",
    )


def _change(results: Mapping[str, Result], ratios: Mapping[str, NDArray[np.float64]]) -> Table:
    lines = []
    for name, label in CHANGED.items():
        former = np.array(results[name]["around"])[:, :PERIODS_BEFORE].mean(1)
        after = [f"{ratio:.2f}" for ratio in ratios[name][PERIODS_BEFORE:]]
        back = [_force(found) for found in _insertions(results[name])[1:]]
        lines.append([label, with_interval(former, 2), *after, ", ".join(back) or "-"])
    told = np.array(results[TOLD]["around"]).mean(1)
    after = [""] * (len(lines[0]) - 4)
    ideal = np.array(results["fine rig, ideal"]["around"])[:, :PERIODS_BEFORE].mean()
    lines.append(["ideal, told", f"{ideal:.2f}", f"{told.mean() / ideal:.2f}", *after, "-"])
    seconds = [f"second {i + 1}" for i in range(len(ratios["fine rig, learning"]) - PERIODS_BEFORE)]
    return Table(
        ("fine rig", "before, mN", *seconds, "next insertions, at 80 mN/µm, mN"),
        lines,
        "Mean force before the change, and after it as a share of that. Told is the analytic controller that knows the "
        "stiffness of 120 mN/µm from the start, as a share of the same at 80 mN/µm: what there is to gain.",
    )


def _times(results: Mapping[str, Result]) -> Table:
    found = results["control period"]
    lines = [[name, *(f"{found[name][what]:.1f}" for what in ("planning", "others", "longest"))] for name in TIMED]
    return Table(
        ("fine rig, 20 Hz", "period with planning, ms", "other periods, ms", "longest, ms"),
        lines,
        "Wall time of one rig's radial periods on one core, medians, simulated rig and command layer included.",
    )


def _insertions(result: Result) -> list[Mapping[str, list[float]]]:
    return [insertion for stretch in result["stretches"] for insertion in stretch]


def _force(insertion: Mapping[str, Sequence[float]]) -> str:
    return with_interval(insertion["mean_force_mN"])


def _mean(insertion: Mapping[str, Sequence[float]]) -> float:
    return float(np.mean(insertion["mean_force_mN"]))


def _before(result: Result) -> list[float]:
    return list(np.array(result["around"])[:, :PERIODS_BEFORE].mean(1))


def _fifth(result: Result) -> list[float]:
    return [periods[PERIODS_BEFORE + WITHIN_PERIODS - 1] for periods in result["around"]]


def _quotient(over: Sequence[float], under: Sequence[float]) -> str:
    share, low, high = quotient(over, under)
    return f"{share:.2f} [{low:.2f}, {high:.2f}]"


def _ratios(around: Sequence[Sequence[float]]) -> NDArray[np.float64]:
    means = np.array(around).mean(0)
    return np.asarray(means / means[:PERIODS_BEFORE].mean())


def _drawing_of_insertions(results: Mapping[str, Result]) -> Callable[["Figure"], None]:
    def draw(figure: "Figure") -> None:
        panel = figure.subplots()
        forces = np.array([found["mean_force_mN"] for found in results[LEARNING]["stretches"][0]])
        error = 1.96 * forces.std(1, ddof=1) / np.sqrt(forces.shape[1])
        panel.errorbar(np.arange(1, len(forces) + 1), forces.mean(1), error, marker="o", label="learning")
        for name, color in ((SHIPPED, "C1"), (TAUGHT, "C2")):
            force = _mean(results[name]["stretches"][0][0])
            panel.axhline(force, color=color, linestyle="--", label=name.partition(", ")[2])
        panel.set(xlabel="insertion", ylabel="mean force, mN")
        panel.legend()

    return draw


def _drawing_of_change(results: Mapping[str, Result]) -> Callable[["Figure"], None]:
    def draw(figure: "Figure") -> None:
        panel = figure.subplots()
        for name, label in CHANGED.items():
            around = np.array(results[name]["around"])
            around = around / around[:, :PERIODS_BEFORE].mean()
            seconds = np.arange(around.shape[1]) - PERIODS_BEFORE + 0.5
            mean, error = around.mean(0), 1.96 * around.std(0, ddof=1) / np.sqrt(len(around))
            (line,) = panel.plot(seconds, mean, marker="o", label=label)
            panel.fill_between(seconds, mean - error, mean + error, alpha=0.2, color=line.get_color(), linewidth=0)
        panel.axvline(0, color="#5b6770", linewidth=0.8)
        panel.axhline(MOST_OF_FORMER, color="#5b6770", linewidth=0.8, linestyle=":")
        panel.set(xlabel="seconds since the stiffness changed", ylabel="mean force, share of the former")
        panel.legend()

    return draw


PAGE = Page(Adaptation(), title="Learning while inserting", paper="Beyond the paper", minutes=8.6, present=present)
