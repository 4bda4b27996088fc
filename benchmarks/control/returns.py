"""What a spiking actor gains in control, beside one of plain numbers of the same size; PPO trains both alike.

Run ``python benchmarks/control/returns.py`` (an hour on two cores). It runs ``neurorobo train`` on the examples, from
fresh weights, once for each actor and training seed, into ``runs/control``. Stopped at any time, the same command goes
on. The returns are those of 100 episodes of the seeds 0 to 99, in which nothing is explored; no setting was chosen on
them. Beside itself it writes a file for each example, and ``table.md`` and ``returns.svg`` from all such files; it
exits with 1 if a spiking actor gains less than is wanted.
"""

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import accumulate
from pathlib import Path
from statistics import fmean, stdev
from typing import Any

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
sys.path.insert(0, str(ROOT / "benchmarks"))

from machine import machine  # noqa: E402

from neurorobo.config.experiment import Experiment, load_experiment  # noqa: E402
from neurorobo.regions.feedforward_config import FeedforwardConfig  # noqa: E402

REGION = "motor_cortex"
WANTED = {"pendulum": -200.0, "double_pendulum": 8000.0}
"""The mean return that each spiking actor is held to, of all its training seeds."""

OUTPUT_RANGES = {"torque": "-2..2 N*m", "push": "-1..1"}
"""Those of the environments' actions: plain numbers need no room on one side, as their fresh weights say the middle."""

ACTORS = ("spiking", "dense")


def overrides(actor: str, experiment: Experiment, seed: int) -> list[str]:
    """Return the changes of an example that train this actor from fresh weights, with this seed in all phases."""
    seeds = [f"train.{i}.seed={seed}" for i in range(len(experiment.train))]
    if actor == "spiking":
        return [f"regions.{REGION}.weights=null", *seeds]
    spiking = experiment.regions[REGION]
    assert isinstance(spiking, FeedforwardConfig)
    ranges = {name: port.range for name, port in spiking.receives.items()} | OUTPUT_RANGES
    inputs, outputs = (
        {name: {"unit": port.unit, "width": port.width, "range": ranges[name]} for name, port in ports.items()}
        for ports in (spiking.receives, spiking.sends)
    )
    network = {"type": "dense_network", "inputs": inputs, "outputs": outputs, "hidden": spiking.hidden}
    return [f"regions.{REGION}={json.dumps(network)}", *seeds]


def train(runs: Path, example: str, actor: str, seed: int) -> dict[str, Any]:
    """Train, or go on, and return what `training.json` says of it."""
    file, folder = ROOT / "examples" / f"{example}.yaml", runs / example / f"{actor}-{seed}"
    changes = overrides(actor, load_experiment(file), seed)
    command = [sys.executable, "-m", "neurorobo.cli.main", "train", str(file), "--threads", "1", "--out", str(folder)]
    command += [word for change in changes for word in ("--set", change)]
    subprocess.run(command, check=True, env={**os.environ, "OMP_NUM_THREADS": "1"})
    phases = json.loads((folder / "training.json").read_text())["phases"]
    found = [phase["evaluation"] for phase in phases]
    returns = found[-1]["held_out"]["after"]["return"]
    print(f"{example} {actor} {seed}: {fmean(returns):.0f}", flush=True)
    return {
        "example": example,
        "actor": actor,
        "seed": seed,
        "mean": round(fmean(returns), 1),
        "half_of_95_percent": round(1.96 * stdev(returns) / len(returns) ** 0.5, 1),
        "worst": round(min(returns), 1),
        "returns": [round(value, 1) for value in returns],
        "minutes": round(sum(phase["seconds"] for phase in phases) / 60, 2),
        "learning_curve": [round(value, 1) for phase in found for value in phase["learning_curve"]],
    }


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return all that was found as a table, a line for each example and actor."""
    lines = [
        "| example | actor | return, mean of all seeds | of each seed, and its 95 % interval | minutes each |",
        "| --- | --- | --- | --- | --- |",
    ]
    for (example, actor), group in grouped(rows).items():
        each = ", ".join(f"{row['mean']:.0f} ± {row['half_of_95_percent']:.0f}" for row in group)
        minutes = fmean(row["minutes"] for row in group)
        mean = fmean(row["mean"] for row in group)
        lines.append(f"| `{example}.yaml` | {actor} | {mean:.0f} | {each} | {minutes:.1f} |")
    return "\n".join(lines) + "\n"


def grouped(rows: Sequence[Mapping[str, Any]]) -> dict[tuple[str, str], list[Mapping[str, Any]]]:
    """Return the rows of each example and actor."""
    groups: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    for row in rows:
        groups.setdefault((row["example"], row["actor"]), []).append(row)
    return groups


def draw(rows: Sequence[Mapping[str, Any]], file: Path) -> None:
    """Draw the return while exploring against the episodes, each training seed a line."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    groups = grouped(rows)
    examples = list(dict.fromkeys(example for example, _ in groups))
    figure = Figure(figsize=(4.5 * len(examples), 3.2), layout="constrained")
    panels = dict(zip(examples, figure.subplots(1, len(examples), squeeze=False)[0], strict=True))
    for (example, actor), group in groups.items():
        phases = load_experiment(ROOT / "examples" / f"{example}.yaml").train
        done = list(accumulate(phase.episodes for phase in phases for _ in range(phase.iterations)))  # type: ignore[attr-defined]
        for number, row in enumerate(group):
            label = None if number else actor
            colour = "tab:blue" if actor == "spiking" else "tab:orange"
            panels[example].plot(done, row["learning_curve"], color=colour, label=label, linewidth=1)
        panels[example].set(title=example, xlabel="episodes", ylabel="return, exploring")
        panels[example].legend()
    with rc_context({"svg.hashsalt": file.stem, "svg.fonttype": "none"}):
        figure.savefig(file, metadata={"Date": None})


def main() -> int:
    """Train, write and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--example", action="append", choices=tuple(WANTED), help="which examples; all by default")
    parser.add_argument("--seeds", type=int, default=5, help="how often each actor is trained, from seed 0 on")
    parser.add_argument("--jobs", type=int, default=2, help="trainings side by side")
    parser.add_argument("--runs", type=Path, default=ROOT / "runs" / "control")
    parser.add_argument("--out", type=Path, default=HERE)
    arguments = parser.parse_args()
    with ThreadPoolExecutor(arguments.jobs) as pool:
        for example in arguments.example or WANTED:
            trainings = [(actor, seed) for seed in range(arguments.seeds) for actor in ACTORS]
            found = list(pool.map(partial(train, arguments.runs, example), *zip(*trainings, strict=True)))
            result = {"machine": machine(), "rows": found}
            (arguments.out / f"{example}.json").write_text(json.dumps(result, indent=1) + "\n")
    files = [file for example in WANTED if (file := arguments.out / f"{example}.json").exists()]
    rows = [row for file in files for row in json.loads(file.read_text())["rows"]]
    (arguments.out / "table.md").write_text(table(rows))
    draw(rows, arguments.out / "returns.svg")
    print(table(rows))
    missed = [
        f"{example}: {mean:.0f}, wanted {WANTED[example]:.0f}"
        for (example, actor), group in grouped(rows).items()
        if actor == "spiking" and (mean := fmean(row["mean"] for row in group)) < WANTED[example]
    ]
    print("\n".join(missed))
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
