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
    DEPTH_GAIN,
    IDEALS,
    OTHER,
    PAPER_RIG,
    SHIPPED,
    Ideal,
    Ppo,
    Training,
    trainings,
)
from precision_interaction.reproduce.row import Result, Setting

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LEAST_FALL, MOST_MINUTES = 0.1, 30.0
MOST = {"steps": 27.0, "mean_force_mN": 19.5, "max_force_mN": 43.0}
METRICS = {"steps": "steps", "mean_force_mN": "mean force, mN", "max_force_mN": "largest force, mN"}
WORDS = (
    "`examples/peg_in_hole_ppo.yaml`: the brain as it ships, which was taught the proportional law, learns on rigs "
    "whose contact has an intercept, and doubles on the way or not. Costs are the sums of Eq. 3 over an insertion, the "
    "distance in mm and the force in units of 20 mN, without exploring, on seeds that took part in no training and no "
    "choice. Minutes are processor time on one core.",
)


def cost(found: Mapping[str, Sequence[float]], part: str = "return") -> NDArray[np.float64]:
    """Return the cost of each insertion, or of a part of it."""
    return -np.asarray(found[part], dtype=np.float64)


def parts(found: Mapping[str, Sequence[float]]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return what the distance costs in each insertion, and what the force costs at gamma_f 1."""
    return cost(found, "distance_return"), cost(found, "force_return")


def present(results: Mapping[str, Result], setting: Setting) -> Presentation:
    """Show the gain of every training, what the weight of the force changes, and what analytic controllers do."""
    chosen = trainings(setting)
    seeded = [training for training in chosen if training.force_weight == 1.0]
    tables = [
        Table(
            ("training", "minutes", "cost before", "cost after", "change, paired", *METRICS.values()),
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
            ]
            + [["as shipped", rig, *_insertions(results[name])] for name, rig in SHIPPED.items()],
            "The same brains on both rigs, and the brain before any training.",
        ),
        Table(
            ("controller", "steps", "mean force, mN", "cost of the distance", "cost of the force at gamma_f 1"),
            [
                *(_parts(name, results[name], results[name]) for name in SHIPPED),
                *(_parts(t.name, results[t.name]["held_out"]["after"], results[t.name]["parts"]) for t in chosen),
                *(_parts(_analytic(ideal), results[name], results[name]) for name, ideal in IDEALS.items()),
            ],
            "Both parts of Eq. 3, each controller on its own rig. Analytic controllers know the contact of the paper's "
            "rig; how it grows with depth they are not told, so that they are no ideal on the rig with depth gain. "
            "They go no faster than the speed of their name.",
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
            f"Time against force on the {DEEP_RIG}: brains trained there, {_seeds(chosen)}, the brain as shipped, and "
            "the analytic controllers of the last table, which are not told how the contact grows. Right: the trained "
            "brains alone.",
            _pareto(chosen, results),
            (8.0, 3.4),
        ),
    ]
    return Presentation([*WORDS, *_words(chosen, results)], tables, pictures, _misses(chosen, results))


def _words(chosen: Sequence[Training], results: Mapping[str, Result]) -> list[str]:
    """Say what training on one rig does on the other, and how time, force and both parts of the cost hang together."""
    words = []
    for rig, other in OTHER.items():
        there = [results[t.name]["other_rig"] for t in chosen if t.rig == rig and t.force_weight == 1.0]
        change = np.mean([cost(found).mean() for found in there]) / cost(results[f"as shipped, {other}"]).mean() - 1.0
        words.append(f"Brains that were trained on the {rig} cost {100 * change:+.0f} % on the {other}.")
    forces = []
    for weight, after in _by_weight(chosen, results).items():
        steps, force_mN = (np.mean([found[name] for found in after]) for name in ("steps", "mean_force_mN"))
        forces.append(f"{steps:.1f} steps at {force_mN:.1f} mN with {weight:g}")
    words.append(f"On the {DEEP_RIG} the brains take, by `gamma_f`: {', '.join(forces)}.")
    for rig in DEPTH_GAIN:
        by_speed = {ideal.speed_um_s: results[name] for name, ideal in IDEALS.items() if ideal.rig == rig}
        fastest, slowest = max(by_speed), min(by_speed)
        fast, slow = (np.array([part.mean() for part in parts(by_speed[speed])]) for speed in (fastest, slowest))
        distance, force = 100 * (slow / fast - 1.0)
        words.append(
            f"Analytic controllers on the {rig} that go no faster than {slowest} µm/s instead of {fastest} change the "
            f"cost of the distance by {distance:+.0f} % and that of the force by {force:+.0f} %."
        )
    return [" ".join(words)]


def _seeds(chosen: Sequence[Training]) -> str:
    """Say how many seeds each weight of the force has on the deep rig."""
    weights = [training.force_weight for training in chosen if training.rig == DEEP_RIG]
    counts = {weight: weights.count(weight) for weight in sorted(set(weights))}
    return "with " + ", ".join(f"{count} of gamma_f {weight:g}" for weight, count in counts.items()) + " (a seed each)"


def _by_weight(chosen: Sequence[Training], results: Mapping[str, Result]) -> dict[float, list[Result]]:
    """Return how the brains that were trained on the deep rig insert, by the weight of the force."""
    there = [training for training in chosen if training.rig == DEEP_RIG]
    return {
        weight: [results[t.name]["held_out"]["after"] for t in there if t.force_weight == weight]
        for weight in sorted({training.force_weight for training in there})
    }


def _by_rig(training: Training, found: Result) -> dict[str, Mapping[str, Sequence[float]]]:
    return {training.rig: found["held_out"]["after"], OTHER[training.rig]: found["other_rig"]}


def _misses(chosen: Sequence[Training], results: Mapping[str, Result]) -> list[str]:
    """Return what the trainings miss of what is wanted, each on its own rig."""
    wanted = Wanted()
    falls: dict[str, list[float]] = {}
    for training in chosen:
        wanted.at_most(f"{training.name}: minutes", results[training.name]["seconds"][-1] / 60, MOST_MINUTES)
    for training in [training for training in chosen if training.force_weight == 1.0]:
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
    return [training.name, f"{found['seconds'][-1] / 60:.1f}", *costs, share, *figures]


def _insertions(found: Mapping[str, Sequence[float]]) -> list[str]:
    inserted = f"{sum(found['success']):.0f} of {len(found['success'])}"
    return [*(with_interval(found[metric]) for metric in METRICS), inserted]


def _parts(name: str, whole: Mapping[str, Sequence[float]], split: Mapping[str, Sequence[float]]) -> list[str]:
    figures = [with_interval(whole[metric]) for metric in ("steps", "mean_force_mN")]
    return [name, *figures, *(with_interval(part.tolist()) for part in parts(split))]


def _analytic(ideal: Ideal) -> str:
    """Return what an analytic controller is called: it is ideal only where it knows the whole contact."""
    told = ", not told" if DEPTH_GAIN[ideal.rig] else ""
    return f"analytic{told}, {ideal.rig}, {ideal.speed_um_s} um/s"


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
    """Return what draws time against force: everything, and beside it the trained brains alone, which lie close."""

    def draw(figure: "Figure") -> None:
        whole, near = figure.subplots(1, 2)
        for panel in (whole, near):
            for number, (marker, (weight, after)) in enumerate(
                zip("osD^v", _by_weight(chosen, results).items(), strict=False)
            ):
                steps, force = ([np.mean(one[name]) for one in after] for name in ("steps", "mean_force_mN"))
                style = {"color": f"C{number}", "markerfacecolor": "none", "label": f"gamma_f {weight:g}"}
                panel.plot(steps, force, marker, **style)
            panel.set(xlabel="steps of 1 s", ylabel="mean force, mN")
        shipped = results[f"as shipped, {DEEP_RIG}"]
        whole.plot(np.mean(shipped["steps"]), np.mean(shipped["mean_force_mN"]), "kx", label="as shipped")
        untold = [results[name] for name, ideal in IDEALS.items() if ideal.rig == DEEP_RIG]
        steps, force = ([np.mean(one[name]) for one in untold] for name in ("steps", "mean_force_mN"))
        whole.plot(steps, force, "--", color="#5b6770", label="analytic, not told")
        near.margins(0.15)
        whole.legend()

    return draw


PAGE = Page(
    Ppo(), title="Fine-tuning the joined brain by PPO", paper="Eq. 3, 13, Sec. IV-D", minutes=22, present=present
)
