"""Every assembly figure of the README: all examples over seeds 0-99, against what is wanted of them.

Run ``python benchmarks/assembly/figures.py`` (some minutes; each row records its own time). It writes
``benchmarks/assembly/latest.json``, prints the table, puts it into the README, and exits with 1 if a figure is missed.
``--only NAME`` measures one row and keeps the others.
"""

import argparse
import hashlib
import json
import platform
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from neurorobo.config.experiment import Experiment, load_experiment
from neurorobo.experiment.build import build_brain, build_task
from neurorobo.experiment.closed_loop import run_episodes
from neurorobo.experiment.recorder import Recorder, Sample, Setting
from neurorobo.experiment.summary import summarise
from neurorobo.experiment.weights import weights_file

sys.path.append(str(Path(__file__).resolve().parents[1]))
from machine import processor
from page import between

ROOT = Path(__file__).resolve().parents[2]
LATEST = Path(__file__).with_name("latest.json")
SEEDS = range(100)
LAST_UM = 50.0
START, END = "<!-- assembly figures: python benchmarks/assembly/figures.py -->", "<!-- end of assembly figures -->"


@dataclass(frozen=True)
class Row:
    """One experiment: its file, what is changed in it, the means wanted, and the paper's figures, if it has any."""

    name: str
    file: str
    overrides: Sequence[str] = ()
    wanted: Mapping[str, list[float]] = field(default_factory=dict)
    paper: str = ""

    def experiment(self) -> Experiment:
        """Load the experiment."""
        return load_experiment(ROOT / "examples" / f"{self.file}.yaml", self.overrides)


def at_most(steps: float, mean_mN: float, largest_mN: float, interventions: float = 0.0) -> dict[str, list[float]]:
    """Return the means wanted, each with its least and its largest: the smaller, the better."""
    return {
        "steps": [0.0, steps],
        "mean_force_mN": [0.0, mean_mN],
        "max_force_mN": [0.0, largest_mN],
        "final_error_um": [0.0, 1.0],
        "command_interventions": [0.0, interventions],
    }


def around(steps: float, mean_mN: float, largest_mN: float) -> dict[str, list[float]]:
    """Return the means wanted of a baseline: within 15 % of what the analytic controller gives in a plain loop."""
    figures = {"steps": steps, "mean_force_mN": mean_mN, "max_force_mN": largest_mN}
    near = {name: [round(0.85 * figure, 4), round(1.15 * figure, 4)] for name, figure in figures.items()}
    return at_most(0, 0, 0) | near


ZIEGLER_NICHOLS = tuple(f"regions.controller.{gain}" for gain in ("kp=1.2", "ki=1.2", "kd=0.3"))
ROWS = (
    Row("spiking, paper rig", "peg_in_hole", (), at_most(28, 24.5, 54, 2), "28 / 25 / 50"),
    Row("spiking, fine rig, radial 5 Hz", "peg_in_hole_fast", (), at_most(28, 10, 25, 2)),
    Row("spiking, fine rig, radial 20 Hz", "peg_in_hole_fast", ("time.radial=50 ms",), at_most(28, 9, 22, 2)),
    Row("teachers, paper rig", "peg_in_hole_teachers", (), at_most(27, 22.5, 49)),
    Row("baseline, force-based (ref. [3])", "baseline_force_based", (), around(103, 18.5, 58), "103 / - / ~100"),
    Row("baseline, model-based (ref. [7])", "baseline_model_based", (), around(25, 85, 127), "26 / 78 / 160"),
    Row("baseline, grid-searched PID", "baseline_pid"),
    Row("baseline, Ziegler-Nichols PID", "baseline_pid", ZIEGLER_NICHOLS),
)  # fmt: skip


class Interventions(Recorder):
    """Counts the commands that the command layer changed, by episode, and those with more than LAST_UM still to go."""

    def __init__(self, setting: Setting) -> None:
        super().__init__(setting)
        self.all: NDArray[np.int64] = np.zeros(len(setting.seeds), dtype=np.int64)
        self.early: NDArray[np.int64] = np.zeros(len(setting.seeds), dtype=np.int64)

    def sample(self, sample: Sample) -> None:
        """Add this tick's, of all actuators."""
        early = sample.observation["remaining"][:, 0] > LAST_UM
        for changed in sample.interventions.values():
            self.all += changed
            self.early += changed * early

    def finish(self) -> None:
        """Nothing is written."""


def run(experiment: Experiment, seeds: Sequence[int]) -> tuple[dict[str, Any], Interventions]:
    """Insert once per seed, all side by side; return the summary and the interventions."""
    brain, task = build_brain(experiment), build_task(experiment)
    assert task is not None
    interventions = Interventions(Setting(Path(), experiment.name, brain.plan, seeds, task))
    summary = summarise(run_episodes(brain, task, seeds, recorders=[interventions]), task.higher_is_better)
    counted = [episode["command_interventions"] for episode in summary["episodes"]]
    assert counted == interventions.all.tolist(), "the command layer counts otherwise"
    return summary, interventions


def measure(row: Row, seeds: Sequence[int] = SEEDS) -> dict[str, Any]:
    """Run one row over the seeds."""
    experiment = row.experiment()
    started = time.monotonic()
    summary, interventions = run(experiment, seeds)
    return {
        "name": row.name,
        "command": f"neurorobo run examples/{row.file}.yaml --seed {seeds[0]} --episodes {len(seeds)}"
        + "".join(f" --set '{change}'" for change in row.overrides),
        "config_hash": experiment.config_hash,
        "weights_sha256": fingerprints(experiment),
        "paper": row.paper,
        "seeds": [seeds[0], seeds[-1]],
        "inserted": sum(episode["success"] == 1.0 for episode in summary["episodes"]),
        "figures": {
            name: figure for name, figure in summary["aggregate"].items() if name not in ("success", "duration_s")
        },
        "early_interventions": int(interventions.early.sum()),
        "wanted": dict(row.wanted),
        "seconds": round(time.monotonic() - started, 1),
        "machine": machine(),
    }


def fingerprints(experiment: Experiment) -> dict[str, str]:
    """Return the SHA-256 of every weights file of an experiment."""
    files = {name: weights_file(name, experiment) for name, config in experiment.regions.items() if config.weights}
    return {name: hashlib.sha256(file.read_bytes()).hexdigest() for name, file in files.items()}


def machine() -> dict[str, Any]:
    """Return what the times depend on, and the last bits of the figures."""
    return {
        "platform": platform.platform(),
        "cpu": processor(),
        "threads": torch.get_num_threads(),
        "python": platform.python_version(),
        **{name: version(name) for name in ("torch", "numpy")},
    }


def misses(row: Mapping[str, Any]) -> list[str]:
    """Return in words what a measured row falls short of."""
    found = [] if row["inserted"] == len(SEEDS) else [f"inserted {row['inserted']} of {len(SEEDS)}"]
    if row["figures"]["overshoot_um"]["worst"] > 0:
        found.append(f"overshoots by {row['figures']['overshoot_um']['worst']:.3g} um")
    if row["figures"]["final_error_um"]["worst"] > 1.0:
        found.append(f"final error {row['figures']['final_error_um']['worst']:.3g} um")
    if row["early_interventions"] and "spiking" in row["name"]:
        found.append(f"{row['early_interventions']} interventions before the last {LAST_UM:g} um, wanted none")
    for name, (least, largest) in row["wanted"].items():
        mean = row["figures"][name]["mean"]
        if not least <= mean <= largest:
            found.append(f"{name} {mean:.4g}, wanted {least:.4g} to {largest:.4g}")
    return found


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return the README's table."""
    lines = [
        "| experiment | steps of 1 s | mean force, mN | largest force, mN | interventions | before the last 50 µm "
        "| inserted | paper |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for row in rows:
        names = ("steps", "mean_force_mN", "max_force_mN", "command_interventions")
        cells = [_cell(row["figures"][name]) for name in names] + [f"{row['early_interventions']}"]
        lines.append(f"| {row['name']} | {' | '.join(cells)} | {row['inserted']} of {len(SEEDS)} | {row['paper']} |")
    return "\n".join(lines)


def _cell(figure: Mapping[str, float]) -> str:
    return f"{figure['mean']:.1f} ({figure['worst']:.0f})"


def into_readme(text: str, rows: Sequence[Mapping[str, Any]]) -> str:
    """Return the README with its table replaced."""
    return between(text, START, END, table(rows))


def main() -> int:
    """Measure, write and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", action="append", help="measure this row and keep the others")
    only = parser.parse_args().only
    measured = {row.name: measure(row) for row in ROWS if not only or row.name in only}
    known = {row["name"]: row for row in json.loads(LATEST.read_text())["rows"]} if only and LATEST.exists() else {}
    rows = [found for row in ROWS if (found := measured.get(row.name, known.get(row.name)))]
    LATEST.write_text(json.dumps({"rows": rows}, indent=2) + "\n")
    readme = ROOT / "README.md"
    readme.write_text(into_readme(readme.read_text(), rows))
    print(table(rows))
    missed = {row["name"]: found for row in rows if (found := misses(row))}
    for name, found in missed.items():
        print(f"MISSED by {name}: {'; '.join(found)}")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
