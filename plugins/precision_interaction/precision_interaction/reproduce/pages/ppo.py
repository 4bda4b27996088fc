"""How the fine-tuning by PPO is shown."""

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from precision_interaction.reproduce.pages.page import Page, Picture, Presentation, Table, Wanted
from precision_interaction.reproduce.pages.statistics import cell as with_interval
from precision_interaction.reproduce.pages.statistics import interval
from precision_interaction.reproduce.ppo import BEFORE, IDEAL_SPEEDS_UM_S, SEEDED, WEIGHTED, Ppo, Training, trainings
from precision_interaction.reproduce.row import Result, Setting

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LEAST_FALL = 0.1
MOST = {"steps": 27.0, "mean_force_mN": 19.5, "max_force_mN": 43.0}
METRICS = {"steps": "steps", "mean_force_mN": "mean force, mN", "max_force_mN": "largest force, mN"}
WORDS = (
    "`examples/peg_in_hole_ppo.yaml`: the brain as it ships, which was taught the proportional law, on a rig whose "
    "contact has an intercept and doubles on the way. Costs are the sums of Eq. 3 over an insertion, the distance in "
    "mm and the force in units of 20 mN, without exploring, on seeds that took part in no training and no choice.",
    "`gamma_f` does not move the best speed. Both parts of Eq. 3 are sums over control periods, and a slower insertion "
    "has more of them: the variance of the contact grows with the distance covered, however many moves that takes, "
    "while each further move adds its own intercept and the rounding of the stage. So what lowers the first part "
    "lowers the second, as the ideal controllers below show; time is traded against the mean force alone.",
)


def cost(found: Mapping[str, Sequence[float]], part: str = "return") -> NDArray[np.float64]:
    """Return the cost of each insertion, or of a part of it."""
    return -np.asarray(found[part], dtype=np.float64)


def present(results: Mapping[str, Result], setting: Setting) -> Presentation:
    """Show the gain of every seed, what the weight of the force changes, and what an ideal controller could do."""
    wanted = Wanted()
    seeded, weighted = trainings(setting, SEEDED), trainings(setting, WEIGHTED)
    everyone = sorted([*seeded, *weighted], key=lambda training: (training.force_weight, training.seed))
    tables = [
        Table(
            (
                "training",
                "cost before",
                "cost after",
                "change, paired",
                *(f"{name}, after" for name in METRICS.values()),
            ),
            [_gain(training, results[training.name]) for training in everyone],
            "On the rig of the training. Means over the insertions, with 95 % intervals from a bootstrap; the changes "
            "are of the same insertion before and after. Costs of different weights cannot be compared.",
        ),
        Table(
            ("brain", *METRICS.values(), "inserted"),
            [
                _insertions("as it ships", results[BEFORE]),
                *(_insertions(training.name, results[training.name]["paper_rig"]) for training in everyone),
            ],
            "The same brains on the paper's rig, `examples/peg_in_hole.yaml`, without depth gain.",
        ),
        Table(
            ("largest speed, µm/s", "steps", "mean force, mN", "cost of the distance", "cost of the force, gamma_f 1"),
            [_ideal(speed, results[name]) for name, speed in IDEAL_SPEEDS_UM_S.items()],
            "Analytic controllers that know the contact, on the paper's rig, and go no faster than so.",
        ),
    ]
    falls = [1.0 - cost(results[t.name]["held_out"]["after"]).mean() / _before(results[t.name]) for t in seeded]
    wanted.at_least("gamma_f 1: the mean fall of the cost", float(np.mean(falls)), LEAST_FALL)
    for training in seeded:
        _judge(training, results[training.name], wanted)
    pictures = [
        Picture(
            "ppo_learning",
            "Mean cost of the insertions that each iteration explores, by processor time, for five seeds at gamma_f 1.",
            _learning([results[training.name] for training in seeded]),
            (6.0, 3.4),
        ),
        Picture(
            "ppo_pareto",
            "Time against force: the trained brains on their own rig, each with its gamma_f, and the ideal controllers "
            "of the last table on the paper's.",
            _pareto(everyone, results),
            (6.0, 3.4),
        ),
    ]
    return Presentation(WORDS, tables, pictures, wanted.misses)


def _before(found: Result) -> float:
    return float(cost(found["held_out"]["before"]).mean())


def _judge(training: Training, found: Result, wanted: Wanted) -> None:
    """Note what a seed misses, on its own rig and on the paper's."""
    before, after = found["held_out"]["before"], found["held_out"]["after"]
    _, _, highest = interval((cost(after) - cost(before)).tolist())
    wanted.at_most(f"{training.name}: upper end of the change of the cost", highest, 0.0)
    largest = float(np.mean(before["max_force_mN"]))
    wanted.at_most(f"{training.name}: largest force, mN", float(np.mean(after["max_force_mN"])), largest)
    for metric, most in MOST.items():
        what = f"{training.name}, paper rig: {METRICS[metric]}"
        wanted.at_most(what, float(np.mean(found["paper_rig"][metric])), most)
    for rig, insertions in (("own rig", after), ("paper rig", found["paper_rig"])):
        wanted.that(f"{training.name}, {rig}: not all were inserted", all(insertions["success"]))
        wanted.at_most(f"{training.name}, {rig}: largest final error, um", max(insertions["final_error_um"]), 1.0)


def _gain(training: Training, found: Result) -> list[str]:
    before, after = found["held_out"]["before"], found["held_out"]["after"]
    change = cost(after) - cost(before)
    share = f"{100 * change.mean() / cost(before).mean():+.0f} %: {with_interval(change.tolist())}"
    figures = [with_interval(after[name]) for name in METRICS]
    return [training.name, with_interval(cost(before).tolist()), with_interval(cost(after).tolist()), share, *figures]


def _insertions(name: str, found: Mapping[str, Sequence[float]]) -> list[str]:
    inserted = f"{sum(found['success']):.0f} of {len(found['success'])}"
    return [name, *(with_interval(found[metric]) for metric in METRICS), inserted]


def _ideal(speed: float, found: Mapping[str, Sequence[float]]) -> list[str]:
    parts = [with_interval(cost(found, part).tolist()) for part in ("distance_return", "force_return")]
    return [f"{speed:g}", *(with_interval(found[metric]) for metric in ("steps", "mean_force_mN")), *parts]


def _learning(found: Sequence[Result]) -> Callable[["Figure"], None]:
    def draw(figure: "Figure") -> None:
        panel = figure.subplots()
        for number, one in enumerate(found):
            panel.plot(np.array(one["seconds"]) / 60, -np.array(one["learning_curve"]), "o-", color=f"C{number}")
        panel.set(xlabel="minutes", ylabel="cost while exploring")

    return draw


def _pareto(everyone: Sequence[Training], results: Mapping[str, Result]) -> Callable[["Figure"], None]:
    def draw(figure: "Figure") -> None:
        panel = figure.subplots()
        for number, weight in enumerate(sorted({training.force_weight for training in everyone})):
            after = [results[t.name]["held_out"]["after"] for t in everyone if t.force_weight == weight]
            steps, force = ([np.mean(one[name]) for one in after] for name in ("steps", "mean_force_mN"))
            panel.plot(steps, force, "o", color=f"C{number}", label=f"gamma_f {weight:g}")
        ideal = [results[name] for name in IDEAL_SPEEDS_UM_S]
        steps, force = ([np.mean(one[name]) for one in ideal] for name in ("steps", "mean_force_mN"))
        panel.plot(steps, force, "--", color="#5b6770", label="ideal, paper rig")
        panel.set(xlabel="steps of 1 s", ylabel="mean force, mN")
        panel.legend()

    return draw


PAGE = Page(
    Ppo(), title="Fine-tuning the joined brain by PPO", paper="Eq. 3, 13, Sec. IV-D", minutes=25, present=present
)
