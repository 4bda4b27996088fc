"""Whether training from scratch gives what is shipped: trains the example, and inserts with both sets of weights.

Run ``python benchmarks/training/from_scratch.py`` (half an hour on two cores). It runs ``neurorobo train`` into
``runs/from_scratch``, then the same insertions with both sets of weights, over seeds from 1000 on. Stopped at any time,
the same command goes on. It writes ``from_scratch.json`` into the folder, prints what it found, and exits with 1 if
training took longer than is wanted or a figure is further off than is wanted.
"""

import argparse
import json
import runpy
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from neurorobo.config.experiment import load_experiment

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "examples" / "peg_in_hole.yaml"
FIRST_SEED = 1000
COMPARED = ("steps", "mean_force_mN", "max_force_mN")

WANTED_MINUTES = 60.0
WANTED_DIFFERENCE = 0.1
"""The largest difference of a mean figure, as a share of that of the shipped weights."""


def train(folder: Path, threads: int, overrides: Sequence[str]) -> dict[str, Any]:
    """Train, or go on, and return the minutes that the phases took in all sessions together, by phase and in all."""
    command = [str(Path(sys.executable).with_name("neurorobo")), "train", str(EXAMPLE)]
    command += [word for change in overrides for word in ("--set", change)]
    subprocess.run([*command, "--out", str(folder), "--threads", str(threads)], check=True)
    phases = json.loads((folder / "training.json").read_text())["phases"]
    minutes = [round(phase["seconds"] / 60, 2) for phase in phases]
    return {"threads": threads, "minutes_of_each_phase": minutes, "minutes": round(sum(minutes), 2)}


def insert(name: str, overrides: Sequence[str], folder: Path, episodes: int) -> dict[str, Any]:
    """Insert with these weights, or return what an earlier call has found with the very same ones."""
    benchmark = runpy.run_path(str(ROOT / "benchmarks" / "assembly" / "figures.py"))
    seeds = range(FIRST_SEED, FIRST_SEED + episodes)
    file = folder / f"{name}.json"
    row = benchmark["Row"](name, EXAMPLE.stem, overrides)
    if file.exists():
        found: dict[str, Any] = json.loads(file.read_text())
        known = (found["config_hash"], found["weights_sha256"], found["seeds"])
        experiment = row.experiment()
        if known == (experiment.config_hash, benchmark["fingerprints"](experiment), [seeds[0], seeds[-1]]):
            return found
    found = benchmark["measure"](row, seeds)
    file.write_text(json.dumps(found, indent=2) + "\n")
    return found


def misses(result: Mapping[str, Any], episodes: int) -> list[str]:
    """Return in words what is not as wanted."""
    minutes, shipped, trained = result["training"]["minutes"], result["shipped"], result["trained"]
    found = [f"training took {minutes:.0f} minutes, wanted {WANTED_MINUTES:g}"] if minutes > WANTED_MINUTES else []
    if trained["inserted"] < episodes:
        found.append(f"inserted {trained['inserted']} of {episodes}")
    for name in COMPARED:
        ours, theirs = (row["figures"][name]["mean"] for row in (trained, shipped))
        if abs(ours - theirs) > WANTED_DIFFERENCE * theirs:
            found.append(f"{name} {ours:.4g}, with the shipped weights {theirs:.4g}")
    return found


def main() -> int:
    """Train, insert, write and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "runs" / "from_scratch")
    parser.add_argument("--episodes", type=int, default=50)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--set", action="append", default=[], dest="overrides", help="a change of the example")
    arguments = parser.parse_args()
    folder, overrides = arguments.out.resolve(), arguments.overrides
    training = train(folder, arguments.threads, overrides)
    regions = dict.fromkeys(name for phase in load_experiment(EXAMPLE).train for name in phase.pupils)  # type: ignore[attr-defined]
    own = [f"regions.{name}.weights={folder / f'{name}.safetensors'}" for name in regions]
    result = {
        "training": training,
        "shipped": insert("shipped", overrides, folder, arguments.episodes),
        "trained": insert("trained", [*overrides, *own], folder, arguments.episodes),
    }
    (folder / "from_scratch.json").write_text(json.dumps(result, indent=2) + "\n")
    print(f"training {training['minutes']:.1f} minutes on {training['threads']} threads")
    for name in COMPARED:
        ours, theirs = (result[which]["figures"][name]["mean"] for which in ("trained", "shipped"))
        print(f"{name:15} trained {ours:8.3f}  shipped {theirs:8.3f}")
    missed = misses(result, arguments.episodes)
    print("\n".join(f"MISSED: {miss}" for miss in missed))
    return int(bool(missed))


if __name__ == "__main__":
    sys.exit(main())
