"""How Fig. 11 to 13 and Table I are shown."""

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from precision_interaction.reproduce.assembly import CASES, METRICS, TRACE_SEED, TRACED, Assembly
from precision_interaction.reproduce.pages.page import Page, Picture, Presentation, Table, Wanted
from precision_interaction.reproduce.pages.statistics import cell as with_interval
from precision_interaction.reproduce.row import Result, Setting

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def present(results: Mapping[str, Result], setting: Setting) -> Presentation:
    """Show the table and the three figures."""
    lines, wanted = [], Wanted()
    for name, case in CASES.items():
        found = results[name]
        ours = " / ".join(with_interval(found[metric]) for metric in METRICS)
        inserted = sum(success == 1.0 for success in found["success"])
        lines.append([name, case.paper, case.ideal, ours, f"{inserted} of {len(found['success'])}"])
        if case.wanted is not None:
            for metric, most in zip(METRICS, case.wanted, strict=True):
                wanted.at_most(f"{name}: {METRICS[metric]}", float(np.mean(found[metric])), most)
        if name.startswith("brain"):
            wanted.that(f"{name}: not all were inserted", inserted == len(found["success"]))
            wanted.at_most(f"{name}: largest final error, um", max(found["final_error_um"]), 1.0)
            wanted.at_most(f"{name}: largest overshoot, um", max(found["overshoot_um"]), 0.0)
    heads = ("controller and rig", "paper", "ideal, no spiking", "ours", "inserted")
    caption = (
        "Steps of 1 s / mean force / largest force in mN: means over the runs, with 95 % intervals from a "
        "bootstrap. The ideal is an analytic controller in a plain loop."
    )
    plain, deep = (
        float(np.mean(results[name]["max_force_mN"]))
        for name in ("force-based, ref. [3]", "force-based, with depth gain")
    )
    words = (
        "The force-based method inserts 20 µm at a time; the model-based one accelerates, cruises and brakes as "
        "the stage allows. The paper's ~100 mN for the force-based method needs a contact that grows with depth: "
        f"with one that has doubled at the end, its largest force is {deep:.0f} mN in place of {plain:.0f}, so "
        "that growth alone does not explain it.",
    )
    pictures = [
        Picture(
            name,
            f"{paper}: {case}, seed {TRACE_SEED}. Left: distance covered and axial speed. Right: radial force and "
            "radial move. Distance and force are those at the start of each period, moves and speeds hold for one.",
            _drawing(results[case]["trace"]),
            (7.5, 4.2),
        )
        for name, (case, paper) in TRACED.items()
    ]
    return Presentation(words, [Table(heads, lines, caption)], pictures, wanted.misses)


def _drawing(trace: Sequence[Sequence[float]]) -> Callable[["Figure"], None]:
    """Return what draws a trace as the paper does."""

    def draw(figure: "Figure") -> None:
        time, remaining, speed, force_x, force_y, move_x, move_y = np.asarray(trace).T
        edges = np.append(time, 2 * time[-1] - time[-2])  # what is commanded holds for a period, the last one too
        held: dict[str, Any] = {"baseline": None, "linewidth": 1.4}
        panels = figure.subplots(2, 2, sharex=True)
        panels[0, 0].plot(time, remaining[0] - remaining)
        panels[0, 0].set_ylabel("distance, µm")
        panels[1, 0].stairs(speed, edges, **held)
        panels[1, 0].set_ylabel("axial speed, µm/s")
        panels[0, 1].plot(time, force_x, label="x")
        panels[0, 1].plot(time, force_y, label="y")
        panels[0, 1].set_ylabel("radial force, mN")
        panels[0, 1].legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=2)
        panels[1, 1].stairs(move_x, edges, **held)
        panels[1, 1].stairs(move_y, edges, color="C1", **held)
        panels[1, 1].set_ylabel("radial move, µm")
        for panel in panels[1]:
            panel.set_xlabel("time, s")

    return draw


PAGE = Page(
    Assembly(),
    title="Assembly by the brain and by two other methods",
    paper="Fig. 11-13, Table I",
    minutes=1.2,
    present=present,
)
