"""Every assembly figure of the README: all examples over seeds 0-99, against what is wanted of them.

Run ``python benchmarks/assembly/figures.py`` (minutes). It writes ``benchmarks/assembly/latest.json``, prints the
table, puts it into the README, and exits with 1 if a figure is missed. ``--only NAME`` measures one row and keeps the
others.
"""

import argparse
import json
import platform
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
LATEST = Path(__file__).with_name("latest.json")
SEEDS = range(100)
LAST_UM = 50.0
START, END = "<!-- assembly figures: python benchmarks/assembly/figures.py -->", "<!-- end of assembly figures -->"


@dataclass(frozen=True)
class Row:
    """One experiment: its file, what is changed in it, the largest means wanted, and the paper's figures if any."""

    name: str
    file: str
    overrides: Sequence[str] = ()
    wanted: Mapping[str, float] = field(default_factory=dict)
    paper: str = ""


def at_most(steps: float, mean_mN: float, largest_mN: float, interventions: float = 0.0) -> dict[str, float]:
    """Return the largest means wanted."""
    return {
        "steps": steps,
        "mean_force_mN": mean_mN,
        "max_force_mN": largest_mN,
        "final_error_um": 1.0,
        "command_interventions": interventions,
    }


def around(steps: float, mean_mN: float, largest_mN: float) -> dict[str, float]:
    """Return the largest means wanted of a baseline: 15 % above what the analytic controller gives in a plain loop."""
    return at_most(1.15 * steps, 1.15 * mean_mN, 1.15 * largest_mN)


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


def measure(row: Row) -> dict[str, Any]:
    """Run one row over all seeds."""
    from neurorobo.config.experiment import load_experiment
    from neurorobo.experiment.run import run_experiment
    from neurorobo.plugins import Registry

    registry = Registry.discover()
    experiment = load_experiment(ROOT / "examples" / f"{row.file}.yaml", row.overrides, registry)
    started = time.monotonic()
    folder = ROOT / "runs" / "figures" / f"{time.strftime('%Y%m%d-%H%M%S')}-{experiment.config_hash[:8]}"
    summary = run_experiment(experiment, registry, SEEDS, folder, record=("trajectory",)).summary
    episodes = summary["episodes"]
    return {
        "name": row.name,
        "command": f"neurorobo run examples/{row.file}.yaml --seed 0 --episodes 100"
        + "".join(f" --set '{change}'" for change in row.overrides),
        "config_hash": experiment.config_hash,
        "paper": row.paper,
        "seeds": [SEEDS.start, SEEDS.stop - 1],
        "inserted": sum(episode["success"] == 1.0 for episode in episodes),
        "figures": {
            name: figure for name, figure in summary["aggregate"].items() if name not in ("success", "duration_s")
        },
        "early_interventions": early_interventions(folder / "trajectory.parquet"),
        "wanted": dict(row.wanted),
        "seconds": round(time.monotonic() - started, 1),
    }


def early_interventions(trajectory: Path) -> int:
    """Count, over all runs, the axial commands that were changed with more than the last 50 um still to go."""
    import numpy as np
    import pyarrow.parquet

    table = pyarrow.parquet.read_table(trajectory)
    wanted, given, remaining = (
        table[name].to_numpy() for name in ("plan.speed", "command.axial_speed", "body.remaining")
    )
    return int(np.sum((np.abs(wanted - given) > 1e-3) & (remaining > LAST_UM)))


def misses(row: Mapping[str, Any]) -> list[str]:
    """Return in words what a measured row falls short of."""
    found = [] if row["inserted"] == len(SEEDS) else [f"inserted {row['inserted']} of {len(SEEDS)}"]
    if row["figures"]["overshoot_um"]["worst"] > 0:
        found.append(f"overshoots by {row['figures']['overshoot_um']['worst']:.3g} um")
    if row["figures"]["final_error_um"]["worst"] > 1.0:
        found.append(f"final error {row['figures']['final_error_um']['worst']:.3g} um")
    if row["early_interventions"] and "spiking" in row["name"]:
        found.append(f"{row['early_interventions']} interventions before the last {LAST_UM:g} um, wanted none")
    for name, limit in row["wanted"].items():
        mean = row["figures"][name]["mean"]
        if mean > limit:
            found.append(f"{name} {mean:.4g}, wanted at most {limit:.4g}")
    return found


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return the README's table."""
    lines = [
        "| experiment | steps of 1 s | mean force, mN | largest force, mN | inserted | paper |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for row in rows:
        cells = [_cell(row["figures"][name]) for name in ("steps", "mean_force_mN", "max_force_mN")]
        lines.append(f"| {row['name']} | {' | '.join(cells)} | {row['inserted']} of {len(SEEDS)} | {row['paper']} |")
    return "\n".join(lines)


def _cell(figure: Mapping[str, float]) -> str:
    return f"{figure['mean']:.1f} ({figure['worst']:.0f})"


def into_readme(text: str, rows: Sequence[Mapping[str, Any]]) -> str:
    """Return the README with its table replaced."""
    before, rest = text.split(START)
    _, after = rest.split(END)
    return f"{before}{START}\n\n{table(rows)}\n\n{END}{after}"


def main() -> int:
    """Measure, write and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", action="append", help="measure this row and keep the others")
    only = parser.parse_args().only
    measured = {row.name: measure(row) for row in ROWS if not only or row.name in only}
    known = {row["name"]: row for row in json.loads(LATEST.read_text())["rows"]} if only and LATEST.exists() else {}
    rows = [found for row in ROWS if (found := measured.get(row.name, known.get(row.name)))]
    LATEST.write_text(json.dumps({"machine": platform.platform(), "rows": rows}, indent=2) + "\n")
    readme = ROOT / "README.md"
    readme.write_text(into_readme(readme.read_text(), rows))
    print(table(rows))
    missed = {row["name"]: found for row in rows if (found := misses(row))}
    for name, found in missed.items():
        print(f"MISSED by {name}: {'; '.join(found)}")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
