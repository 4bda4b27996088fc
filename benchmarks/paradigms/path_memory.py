"""How well the liquid state machine of ``examples/path_memory.yaml`` recalls paths, and where it fails.

Run ``python benchmarks/paradigms/path_memory.py`` (six and a half minutes of one core). The seeds 0 to 4 draw the
network, the disturbances and, where they are not given, the paths. Beside itself it writes ``path_memory.json`` with
every run, and from it ``path_memory.svg`` and the table of ``docs/how_to/remember_a_path.md``; ``--draw`` does the
latter alone.
"""

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np
import torch

from neurorobo.config.experiment import load_experiment
from neurorobo.experiment.build import build_brain, build_task
from neurorobo.experiment.closed_loop import run_episodes
from neurorobo.experiment.plan import build_plan
from neurorobo.experiment.recorder import Sample
from neurorobo.plugins import Registry

sys.path.append(str(Path(__file__).parents[1]))
from machine import machine

HERE = Path(__file__).parent
PROJECT = HERE.parents[1]
EXAMPLE = PROJECT / "examples" / "path_memory.yaml"
PAGE = PROJECT / "docs" / "how_to" / "remember_a_path.md"
SEEDS = range(5)
FIGURES = ("waypoints_reached", "deviation_m", "steps_until_lost", "success")

NO_RECURRENCE = "regions.ca3.recurrent_strength=0"
LOCAL_RULE = {
    "type": "plastic_network",
    "inputs": {"spikes": {"unit": "1", "range": "0..1", "code": {"type": "population_uniform", "neurons": 400}}},
    "outputs": {
        "said": {"unit": "m", "width": 2, "range": "0..1 m", "code": {"type": "population_uniform", "neurons": 20}}
    },
    "modulators": {"error": {"unit": "m", "width": 2, "initial": "0 m"}},
    "gain": 0.5,
    "layers": {
        "output": {
            "neurons": 40,
            "reads": ["spikes"],
            "neuron": {"type": "lif", "threshold": 1, "decay": 0.9},
            "synapses": {
                "spikes": {
                    "bounds": "-1..1",
                    "learns": [{"type": "eprop", "modulator": "error", "learning_rate": 0.001}],
                }
            },
        }
    },
}


def corridor(length: float) -> str:
    """Return the path through a corridor, around the left, through it again and to the right."""
    low, high = 0.5 - length / 2, 0.5 + length / 2
    left, right = [[0.2, high], [0.2, low]], [[0.8, high], [0.8, low]]
    through = [[0.5, low], [0.5, high]]
    return f"body.paths={json.dumps([[*through, *left, *through, *right]])}"


GROUPS: Mapping[str, Mapping[str, Sequence[str]]] = {
    "figure of eight": {
        "as in the file": [],
        "no recurrence": [NO_RECURRENCE],
        "currents of 5 ms": ["regions.ca3.synapses=5 ms"],
        "not taught": ["body.led_runs=0", "body.guided_runs=0"],
        "led once": ["body.guided_runs=0"],
        "led seven times, not guided": ["body.led_runs=7", "body.guided_runs=0"],
        "e-prop": [f"regions.ca1={json.dumps(LOCAL_RULE)}"],
    },
    "corridor, m": {str(length): [corridor(length)] for length in (0.1, 0.3, 0.5)},
    "waypoints": {str(n): [f"body.paths={{waypoints: {n}}}"] for n in (4, 8, 12)},
    "waypoints, no recurrence": {str(n): [f"body.paths={{waypoints: {n}}}", NO_RECURRENCE] for n in (4, 8, 12)},
    "paths": {str(n): [f"body.paths={{number: {n}, waypoints: 8}}"] for n in (2, 3)},
    "pushed, m/s": {str(v): [f"body.recall_disturbance={v} m/s"] for v in (0.02, 0.05, 0.1)},
    "put off the start, m": {str(d): [f"body.start_offset={d} m"] for d in (0.05, 0.1)},
    "sensor noise, m": {str(d): [f"body.sensor_noise={d} m"] for d in (0.01, 0.02)},
}
"""What is measured: of each group, by a label, what is changed in the file."""

TRACED = [("figure of eight", "as in the file"), ("figure of eight", "no recurrence")]
"""Of which the way that was walked alone is kept."""


COLOURS = ("#0072b2", "#d55e00", "#009e73")


class Walk:
    """Records where an agent went alone."""

    most_neurons = 0

    def __init__(self) -> None:
        self.places_m: list[list[float]] = []

    def sample(self, sample: Sample) -> None:
        """Keep a place, to the millimetre."""
        if sample.observation["alone"][0, 0]:
            self.places_m.append(np.round(sample.observation["place"][0], 3).tolist())


def measure(seed: int, changes: Sequence[str], registry: Registry, traced: bool) -> dict[str, Any]:
    """Run an episode of one seed, and return its figures."""
    experiment = load_experiment(EXAMPLE, [f"seed={seed}", *changes], registry)
    walk = Walk()
    (result,) = run_episodes(
        build_brain(experiment, build_plan(experiment)), build_task(experiment), [seed], recorders=[walk]
    )
    row: dict[str, Any] = {"seed": seed, **{name: round(result.metrics[name], 4) for name in FIGURES}}
    return row | ({"walked_m": walk.places_m} if traced else {})


def still_differs(seed: int, changes: Sequence[str], registry: Registry) -> float:
    """Return how different two liquids are 300 ms after agents that stood elsewhere came to one place.

    The sum over neurons of the differences of spike counts in 50 ms, as a part of all spikes.
    """
    experiment = load_experiment(EXAMPLE, [f"seed={seed}", *changes], registry)
    brain = build_brain(experiment, build_plan(experiment))
    liquid = brain.region("ca3")
    code = liquid.input_ports["place"].code
    assert code is not None
    counts = []
    for start_m in (0.2, 0.8):
        state = liquid.init_state(1)
        for place_m in [start_m] * 10 + [0.5] * 6:
            spikes = code.encode(torch.full((1, 2), place_m), liquid.clock.window)
            spoken, state = liquid.step({"place": spikes}, state)
        counts.append(spoken["spikes"].sum((0, 1)))
    return float((counts[0] - counts[1]).abs().sum() / (counts[0] + counts[1]).sum())


def spread(rows: Sequence[Mapping[str, Any]], figure: str) -> tuple[float, float, float]:
    """Return mean, least and largest."""
    values = [float(row[figure]) for row in rows]
    return fmean(values), min(values), max(values)


def table(groups: Mapping[str, Mapping[str, Sequence[Mapping[str, Any]]]]) -> str:
    """Return the table of the page."""
    lines = [
        "| what | waypoints reached | deviation, mm | complete |",
        "| --- | --- | --- | --- |",
    ]
    for group, labels in groups.items():
        for label, rows in labels.items():
            reached, least, most = (100 * share for share in spread(rows, "waypoints_reached"))
            deviation_mm = 1000 * spread(rows, "deviation_m")[0]
            complete = sum(row["success"] == 1.0 for row in rows)
            lines.append(
                f"| {group}: {label} | {reached:.0f} % ({least:.0f} to {most:.0f}) | {deviation_mm:.0f} "
                f"| {complete} of {len(rows)} |"
            )
    return "\n".join(lines)


def into_page(page: str, result: Mapping[str, Any]) -> str:
    """Return the page with the table between its marks."""
    start, end = "<!-- path memory: python benchmarks/paradigms/path_memory.py -->", "<!-- end of path memory -->"
    before, _, rest = page.partition(start)
    _, _, after = rest.partition(end)
    least, most, without = (100 * result["still_differs"][name] for name in ("least", "most", "no recurrence"))
    memory = (
        "What the liquid remembers: 300 ms after two agents that stood at different places have come to the same one, "
        f"{least:.0f} to {most:.0f} % of the spikes still differ, and without recurrence {without:.0f} % at most."
    )
    return f"{before}{start}\n\n{table(result['groups'])}\n\n{memory}\n\n{end}{after}"


def draw(result: Mapping[str, Any], file: Path) -> None:
    """Draw what was walked, and how recall depends on what is asked for."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    groups = result["groups"]
    with rc_context({"svg.hashsalt": file.stem, "svg.fonttype": "none", "font.size": 8}):
        figure = Figure(figsize=(9, 5.6), layout="constrained")
        panels = figure.subplots(2, 3)
        more = {"paths": {"1": groups["waypoints"]["8"]}}
        (led,) = load_experiment(EXAMPLE).body.paths  # type: ignore[union-attr]
        for axes, (group, label), title in zip(
            panels[0], TRACED, ("a  the liquid of the file", "b  without recurrence"), strict=False
        ):
            walked(axes, np.array(led), groups[group][label])
            axes.set_title(title, loc="left")
        for axes, title, unit, shown in (
            (
                panels[0, 2],
                "c  a corridor walked twice",
                "length of the corridor, m",
                {"corridor, m": "as in the file"},
            ),
            (
                panels[1, 0],
                "d  a longer path",
                "waypoints of the path",
                {"waypoints": "as in the file", "waypoints, no recurrence": "no recurrence"},
            ),
            (panels[1, 1], "e  more paths of 8 waypoints", "paths", {"paths": "as in the file"}),
        ):
            for number, (group, name) in enumerate(shown.items()):
                reached(axes, {**more.get(group, {}), **groups[group]}, name, COLOURS[number])
            axes.set_title(title, loc="left")
            axes.set_xlabel(unit)
        disturbed = {"pushed, m/s": "pushed, m/s", "put off the start, m": "put off, m", "sensor noise, m": "noise, m"}
        none = {"0": groups["figure of eight"]["as in the file"]}
        for number, (group, name) in enumerate(disturbed.items()):
            reached(panels[1, 2], {**none, **groups[group]}, name, COLOURS[number])
        panels[1, 1].set_xticks([1, *(int(number) for number in groups["paths"])])
        panels[1, 2].set_title("f  the figure of eight, disturbed", loc="left")
        panels[1, 2].set_xlabel("disturbance")
        for axes in (panels[0, 2], *panels[1]):
            axes.set_ylim(-0.03, 1.05)
            axes.set_xlim(left=0)
            axes.set_ylabel("share of waypoints reached")
            axes.spines[["top", "right"]].set_visible(False)
            if len(axes.lines) > 1:
                axes.legend(frameon=False, loc="lower left" if axes is not panels[1, 2] else "upper right")
        panels[1, 2].set_xlim(0, 0.19)
        figure.savefig(file, metadata={"Date": None})


def walked(axes: Any, led: Any, rows: Sequence[Mapping[str, Any]]) -> None:
    """Draw a path, and how it was walked alone by each seed."""
    for row in rows:
        axes.plot(*np.array(row["walked_m"]).T, color=COLOURS[0], linewidth=0.9, alpha=0.8)
    axes.plot(*led.T, color="black", linewidth=0.8, linestyle="--", marker="o", markersize=3, zorder=0)
    axes.annotate("start", led[0], xytext=(0, -10), textcoords="offset points", ha="center")
    axes.set(xlim=(0, 1), ylim=(0.1, 0.9), aspect="equal", xlabel="x, m", ylabel="y, m")


def reached(axes: Any, labels: Mapping[str, Sequence[Mapping[str, Any]]], name: str, colour: str) -> None:
    """Draw the mean share of waypoints reached, and that of each seed."""
    at = [float(label) for label in labels]
    for x, rows in zip(at, labels.values(), strict=True):
        axes.scatter([x] * len(rows), [row["waypoints_reached"] for row in rows], s=8, color=colour, alpha=0.35)
    means = [spread(rows, "waypoints_reached")[0] for rows in labels.values()]
    axes.plot(at, means, color=colour, marker="o", markersize=4, label=name)


def measure_all(registry: Registry) -> dict[str, Any]:
    """Measure everything, and say what it hangs on."""
    groups: dict[str, dict[str, list[dict[str, Any]]]] = {}
    for group, labels in GROUPS.items():
        for label, changes in labels.items():
            rows = [measure(seed, changes, registry, (group, label) in TRACED) for seed in SEEDS]
            groups.setdefault(group, {})[label] = rows
            print(f"{group}: {label}: {spread(rows, 'waypoints_reached')[0]:.2f} reached", flush=True)
    return {
        "machine": machine(),
        "config_hash": load_experiment(EXAMPLE, registry=registry).config_hash,
        "still_differs": memory(registry),
        "groups": groups,
    }


def memory(registry: Registry) -> dict[str, float]:
    """Return how different liquids still are, the least and the most of the seeds; and the most without recurrence."""
    found = [still_differs(seed, [], registry) for seed in SEEDS]
    without = [still_differs(seed, [NO_RECURRENCE], registry) for seed in SEEDS]
    shares = {"least": min(found), "most": max(found), "no recurrence": max(without)}
    return {name: round(share, 4) for name, share in shares.items()}


def main() -> int:
    """Measure what is asked for, and draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draw", action="store_true", help="draw what was measured before")
    parser.add_argument("--out", type=Path, default=HERE)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    file = arguments.out / "path_memory.json"
    if not arguments.draw:
        result = measure_all(Registry.discover())
        file.write_text(json.dumps(result).replace('{"seed"', '\n{"seed"') + "\n")
    result = json.loads(file.read_text())
    draw(result, arguments.out / "path_memory.svg")
    if arguments.out == HERE:
        PAGE.write_text(into_page(PAGE.read_text(), result))
    return 0


if __name__ == "__main__":
    sys.exit(main())
