"""Insertions on virtual rigs, over their wire protocols, beside the same brain on the simulated body.

Run ``python benchmarks/hardware/insertions.py`` on an otherwise idle machine (20 minutes; ``--episodes`` and ``--rig``
for less). For each rig, `neurorobo emulate` brings it up in a process of its own, and `neurorobo run --arm` inserts
once for each seed from 0 on; the simulation runs the same seeds before, with the same contact law, stiffness and
period. The rigs run side by side, so that each has the other for a neighbour.
Wanted: all insertions succeed, the mean force is within 10 % of the simulation's, and of at least ten minutes of
periods none is late. It writes ``insertions.json`` beside itself, prints what is measured, and exits with 1 if a
figure is missed.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from math import sqrt
from pathlib import Path
from statistics import fmean, stdev
from typing import Any

import yaml

sys.path.append(str(Path(__file__).resolve().parents[1]))
from machine import machine

ROOT = Path(__file__).resolve().parents[2]
HARDWARE = ROOT / "examples" / "peg_in_hole_hardware.yaml"
RESULTS = Path(__file__).with_name("insertions.json")
EPISODES = 23
"""Of some 27 s each: ten minutes of periods, and the 20 seeds that are wanted."""

LARGEST_DIFFERENCE = 0.1
LEAST_S = 600.0


@dataclass(frozen=True)
class Case:
    """A rig, and the experiment whose simulated body it takes the place of."""

    rig: Path
    simulation: Path
    overrides: tuple[str, ...] = ()
    resolution: str = "0.5 um"


CASES = {
    "1 Hz": Case(ROOT / "examples/rigs/shot_ds102.yaml", ROOT / "examples/peg_in_hole.yaml"),
    "20 Hz": Case(
        ROOT / "examples/rigs/pi_venus.yaml",
        ROOT / "examples/peg_in_hole_fast.yaml",
        ("time.radial=50 ms",),
        "0.1 um",
    ),
}


def neurorobo(*words: str) -> list[str]:
    """Return the command line of neurorobo, by this interpreter."""
    return [sys.executable, "-m", "neurorobo.cli.main", *words]


@contextmanager
def emulated(rig: Path, folder: Path) -> Iterator[Path]:
    """Bring a rig up, and yield its file with the addresses of the emulators."""
    written = folder / "rig.yaml"
    process = subprocess.Popen(neurorobo("emulate", str(rig), "--out", str(written)), stdout=subprocess.DEVNULL)
    try:
        ends = time.monotonic() + 60
        while not written.exists():
            if process.poll() is not None or time.monotonic() > ends:
                raise RuntimeError(f"{rig} did not come up")
            time.sleep(0.1)
        yield written
    finally:
        process.terminate()
        process.wait(30)


def run(file: Path, folder: Path, episodes: int, overrides: Sequence[str], *flags: str) -> dict[str, Any]:
    """Run episodes from seed 0 on, and return the summary and the timing."""
    sets = [word for override in overrides for word in ("--set", override)]
    command = neurorobo("run", str(file), "--seed", "0", "--episodes", str(episodes), "--out", str(folder), *sets)
    ended = subprocess.run([*command, *flags, "--set", "record=[]"], stdout=subprocess.DEVNULL, check=False)
    if not (folder / "summary.json").exists():
        raise RuntimeError(f"the run ended with {ended.returncode} and left no summary")
    return {name: json.loads((folder / f"{name}.json").read_text()) for name in ("summary", "timing")}


def hardware_body(case: Case, rig: Path) -> str:
    """Return the body of the hardware example on another rig, as the value of an override."""
    body = yaml.safe_load(HARDWARE.read_text())["body"]
    return json.dumps({**body, "rig": str(rig), "stage_resolution": case.resolution})


def on_rig(case: Case, episodes: int) -> dict[str, Any]:
    """Return what the insertions on an emulated rig came to."""
    with tempfile.TemporaryDirectory() as name, emulated(case.rig, Path(name)) as rig:
        overrides = (*case.overrides, f"body={hardware_body(case, rig)}")
        return run(case.simulation, Path(name) / "run", episodes, overrides, "--arm")


def simulated(case: Case, episodes: int) -> dict[str, Any]:
    """Return what the insertions of the simulated body came to."""
    with tempfile.TemporaryDirectory() as name:
        return run(case.simulation, Path(name) / "run", episodes, case.overrides)


def measure(cases: Sequence[Case], episodes: int) -> Iterator[dict[str, Any]]:
    """Yield the figures of each rig and of its simulation."""
    simulations = [simulated(case, episodes) for case in cases]
    with ThreadPoolExecutor(len(cases)) as pool:
        rigs = list(pool.map(lambda case: on_rig(case, episodes), cases))
    for rig, simulation in zip(rigs, simulations, strict=True):
        yield {"rig": figures(rig), "simulation": figures(simulation), "timing": rig["timing"]}


def figures(ended: dict[str, Any]) -> dict[str, Any]:
    """Return the figures of a run's episodes, and of all together."""
    rows = [
        {name: episode[name] for name in ("seed", "success", "steps", "duration_s", "mean_force_mN", "max_force_mN")}
        for episode in ended["summary"]["episodes"]
    ]
    forces = [row["mean_force_mN"] for row in rows]
    return {
        "inserted": sum(row["success"] == 1.0 for row in rows),
        "mean_force_mN": fmean(forces),
        "standard_error_mN": stdev(forces) / sqrt(len(forces)) if len(forces) > 1 else None,
        "max_force_mN": max(row["max_force_mN"] for row in rows),
        "seconds": sum(row["duration_s"] for row in rows),
        "episodes": rows,
    }


def misses(name: str, measured: dict[str, Any], episodes: int) -> list[str]:
    """Return what is not as wanted."""
    rig, timing = measured["rig"], measured["timing"]
    difference = rig["mean_force_mN"] / measured["simulation"]["mean_force_mN"] - 1
    wanted = {
        f"{rig['inserted']} of {episodes} inserted": rig["inserted"] == episodes,
        f"the mean force differs from the simulation's by {difference:+.1%}": abs(difference) <= LARGEST_DIFFERENCE,
        f"{timing['overruns']} periods were late": timing["overruns"] == 0,
        f"only {rig['seconds']:.0f} s of periods": episodes < EPISODES or rig["seconds"] >= LEAST_S,
    }
    return [f"{name}: {miss}" for miss, is_well in wanted.items() if not is_well]


def main() -> None:
    """Measure, write and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--episodes", type=int, default=EPISODES)
    parser.add_argument("--rig", choices=[*CASES], action="append", help="only this one; may be repeated")
    arguments = parser.parse_args()
    names = arguments.rig or [*CASES]
    results = dict(zip(names, measure([CASES[name] for name in names], arguments.episodes), strict=True))
    missed = []
    for name, measured in results.items():
        for kind in ("rig", "simulation"):
            of = measured[kind]
            error = "" if of["standard_error_mN"] is None else f" ± {of['standard_error_mN']:.2f}"
            print(
                f"{name}, {kind}: {of['inserted']} of {arguments.episodes} inserted, mean force "
                f"{of['mean_force_mN']:.2f}{error} mN, largest {of['max_force_mN']:.1f} mN, {of['seconds']:.0f} s"
            )
        timing = measured["timing"]
        latency = ", ".join(f"{key} {value:.1f} ms" for key, value in timing["latency_ms"].items())
        print(f"{name}: {timing['periods']} periods, {timing['overruns']} late; sensors to commands: {latency}")
        missed += misses(name, measured, arguments.episodes)
    if arguments.episodes >= EPISODES and not arguments.rig:
        RESULTS.write_text(json.dumps({"machine": machine(), "rigs": results}, indent=2) + "\n")
    for miss in missed:
        print(f"MISSED {miss}")
    sys.exit(1 if missed else 0)


if __name__ == "__main__":
    main()
