"""How the fine-tuning by PPO is shown."""

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from precision_interaction.reproduce.pages.page import Page, Picture, Presentation, Table, Wanted
from precision_interaction.reproduce.pages.statistics import cell as with_interval
from precision_interaction.reproduce.pages.statistics import interval
from precision_interaction.reproduce.ppo import (
    DEEP_RIG,
    IDEAL_SPEEDS_UM_S,
    OTHER,
    PAPER_RIG,
    Ppo,
    Training,
    trainings,
)
from precision_interaction.reproduce.row import Result, Setting

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LEAST_FALL = 0.1
MOST = {"steps": 27.0, "mean_force_mN": 19.5, "max_force_mN": 43.0}
METRICS = {"steps": "steps", "mean_force_mN": "mean force, mN", "max_force_mN": "largest force, mN"}
WORDS = (
    "`examples/peg_in_hole_ppo.yaml`: the brain as it ships, which was taught the proportional law, learns on rigs "
    "whose contact has an intercept, and doubles on the way or not. Costs are the sums of Eq. 3 over an insertion, the "
    "distance in mm and the force in units of 20 mN, without exploring, on seeds that took part in no training and no "
    "choice.",
    "`gamma_f` does not move the best speed. Both parts of Eq. 3 are sums over control periods, and a slower insertion "
    "has more of them: the variance of the contact grows with the distance covered, however many moves that takes, "
    "while each further move adds its own intercept and the rounding of the stage. So what lowers the first part "
    "lowers the second, as the ideal controllers below show; time is traded against the mean force alone.",
)


def cost(found: Mapping[str, Sequence[float]], part: str = "return") -> NDArray[np.float64]:
    """Return the cost of each insertion, or of a part of it."""
    return -np.asarray(found[part], dtype=np.float64)


def present(results: Mapping[str, Result], setting: Setting) -> Presentation:
    """Show the gain of every training, what the weight of the force changes, and what an ideal controller could do."""
    chosen = trainings(setting)
    seeded = [training for training in chosen if training.force_weight == 1.0]
    tables = [
        Table(
            ("training", "cost before", "cost after", "change, paired", *METRICS.values()),
            [_gain(training, results[training.name]) for training in chosen],
            "On the rig of the training, before and after it. Means over the insertions, with 95 % intervals from a "
            "bootstrap; the changes are of the same insertion. Costs of different weights cannot be compared.",
        ),
        Table(
            ("trained on", "rig", *METRICS.values(), "inserted"),
            [
                [training.name, rig, *_insertions(found)]
                for training in seeded
                for rig, found in _by_rig(training, results[training.name]).items()
            ],
            "The same brains on both rigs: what is learned on one does not serve the other.",
        ),
        Table(
            ("largest speed, µm/s", "steps", "mean force, mN", "cost of the distance", "cost of the force, gamma_f 1"),
            [_ideal(speed, results[name]) for name, speed in IDEAL_SPEEDS_UM_S.items()],
            "Analytic controllers that know the contact, on the paper's rig, and go no faster than so.",
        ),
    ]
    pictures = [
        Picture(
            "ppo_learning",
            "Mean cost of the insertions that each iteration explores, by processor time, for each seed at gamma_f 1.",
            _learning(seeded, results),
            (7.5, 3.2),
        ),
        Picture(
            "ppo_pareto",
            f"Time against force: brains trained on the {DEEP_RIG}, each with its gamma_f, and the ideal controllers "
            "of the last table.",
            _pareto([training for training in chosen if training.rig == DEEP_RIG], results),
            (6.0, 3.4),
        ),
    ]
    return Presentation(WORDS, tables, pictures, _misses(seeded, results))


def _by_rig(training: Training, found: Result) -> dict[str, Mapping[str, Sequence[float]]]:
    return {training.rig: found["held_out"]["after"], OTHER[training.rig]: found["other_rig"]}


def _misses(seeded: Sequence[Training], results: Mapping[str, Result]) -> list[str]:
    """Return what the trainings miss of what is wanted, each on its own rig."""
    wanted = Wanted()
    falls: dict[str, list[float]] = {}
    for training in seeded:
        name, held_out = training.name, results[training.name]["held_out"]
        before, after = held_out["before"], held_out["after"]
        falls.setdefault(training.rig, []).append(1.0 - float(cost(after).mean() / cost(before).mean()))
        _, _, highest = interval((cost(after) - cost(before)).tolist())
        wanted.at_most(f"{name}: upper end of the change of the cost", highest, 0.0)
        largest_mN = {when: float(np.mean(held_out[when]["max_force_mN"])) for when in ("before", "after")}
        wanted.at_most(f"{name}: largest force, mN", largest_mN["after"], largest_mN["before"])
        wanted.that(f"{name}: not all were inserted", all(after["success"]))
        wanted.at_most(f"{name}: largest final error, um", max(after["final_error_um"]), 1.0)
        if training.rig == PAPER_RIG:
            for metric, most in MOST.items():
                wanted.at_most(f"{name}: {METRICS[metric]}", float(np.mean(after[metric])), most)
    if DEEP_RIG in falls:
        wanted.at_least(f"{DEEP_RIG}: mean fall of the cost", float(np.mean(falls[DEEP_RIG])), LEAST_FALL)
    return wanted.misses


def _gain(training: Training, found: Result) -> list[str]:
    before, after = found["held_out"]["before"], found["held_out"]["after"]
    change = cost(after) - cost(before)
    costs = [with_interval(cost(when).tolist()) for when in (before, after)]
    share = f"{100 * change.mean() / cost(before).mean():+.0f} %: {with_interval(change.tolist())}"
    figures = [" → ".join(f"{np.mean(when[name]):.1f}" for when in (before, after)) for name in METRICS]
    return [training.name, *costs, share, *figures]


def _insertions(found: Mapping[str, Sequence[float]]) -> list[str]:
    inserted = f"{sum(found['success']):.0f} of {len(found['success'])}"
    return [*(with_interval(found[metric]) for metric in METRICS), inserted]


def _ideal(speed: float, found: Mapping[str, Sequence[float]]) -> list[str]:
    parts = [with_interval(cost(found, part).tolist()) for part in ("distance_return", "force_return")]
    return [f"{speed:g}", *(with_interval(found[metric]) for metric in ("steps", "mean_force_mN")), *parts]


def _learning(seeded: Sequence[Training], results: Mapping[str, Result]) -> Callable[["Figure"], None]:
    def draw(figure: "Figure") -> None:
        rigs = list(dict.fromkeys(training.rig for training in seeded))
        panels = figure.subplots(1, len(rigs), squeeze=False)[0]
        for panel, rig in zip(panels, rigs, strict=True):
            for training in seeded:
                if training.rig == rig:
                    found = results[training.name]
                    minutes = np.array(found["seconds"]) / 60
                    panel.plot(minutes, -np.array(found["learning_curve"]), label=f"seed {training.seed}")
            panel.set(xlabel="minutes", ylabel="cost while exploring", title=rig)
            panel.legend()

    return draw


def _pareto(chosen: Sequence[Training], results: Mapping[str, Result]) -> Callable[["Figure"], None]:
    def draw(figure: "Figure") -> None:
        panel = figure.subplots()
        for number, weight in enumerate(sorted({training.force_weight for training in chosen})):
            after = [results[t.name]["held_out"]["after"] for t in chosen if t.force_weight == weight]
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
