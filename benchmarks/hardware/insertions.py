"""Insertions on virtual rigs, over their wire protocols, beside the same brain on the simulated body.

Run ``python benchmarks/hardware/insertions.py`` on an otherwise idle machine (40 minutes; ``--episodes`` and ``--rig``
for less). For each rig, `neurorobo emulate` brings it up in a process of its own, and `neurorobo run --arm` inserts
once for each seed from 0 on; the simulation runs the same seeds, with the same contact law, stiffness and period.
Wanted: all insertions succeed, the mean force is within 10 % of the simulation's, and of at least ten minutes of
periods none is late. Of one that is, it is told whether the machine itself paused in it for as long (:mod:`pauses`), as
virtual machines do at times, whatever runs on them: that excuses nothing, and tells where to look. How many were late
in whole runs before is kept beside the last one, as their number differs from run to run. It writes
``insertions.json`` beside itself and the table of ``docs/how_to/run_on_hardware.md``, prints what is measured, and
exits with 1 if a figure is missed. ``--table`` only writes the table anew.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from math import sqrt
from pathlib import Path
from statistics import fmean, stdev
from typing import Any

import yaml

sys.path.append(str(Path(__file__).resolve().parents[1]))
from machine import machine
from page import between
from pauses import Pause, pauses_of_the_machine

ROOT = Path(__file__).resolve().parents[2]
HARDWARE = ROOT / "examples" / "peg_in_hole_hardware.yaml"
RESULTS = Path(__file__).with_name("insertions.json")
PAGE = ROOT / "docs" / "how_to" / "run_on_hardware.md"
START, END = "<!-- insertions.json -->", "<!-- end of insertions.json -->"
EPISODES = 23
"""Of some 27 s each: ten minutes of periods, and the 20 seeds that are wanted."""

LARGEST_DIFFERENCE = 0.1
LEAST_S = 600.0


@dataclass(frozen=True)
class Case:
    """A rig, and the experiment whose simulated body it takes the place of."""

    rig: Path
    simulation: Path
    period_ms: float
    overrides: tuple[str, ...] = ()
    resolution: str = "0.5 um"


CASES = {
    "1 Hz": Case(ROOT / "examples/rigs/shot_ds102.yaml", ROOT / "examples/peg_in_hole.yaml", 1000.0),
    "20 Hz": Case(
        ROOT / "examples/rigs/pi_venus.yaml",
        ROOT / "examples/peg_in_hole_fast.yaml",
        50.0,
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
    """Return the body of the hardware example on another rig, as an override; late periods are counted."""
    body = yaml.safe_load(HARDWARE.read_text())["body"]
    return json.dumps({**body, "rig": str(rig), "stage_resolution": case.resolution, "overrun": "hold"})


def measure(case: Case, episodes: int) -> dict[str, Any]:
    """Return the figures of one rig and of the simulation."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        simulated = run(case.simulation, folder / "simulated", episodes, case.overrides)
        with emulated(case.rig, folder) as rig, pauses_of_the_machine() as pauses:
            overrides = (*case.overrides, f"body={hardware_body(case, rig)}")
            real = run(case.simulation, folder / "rig", episodes, overrides, "--arm")
    lengths_ms = [(pause.ended_ns - pause.began_ns) / 1e6 for pause in pauses]
    late = with_pauses(real["timing"].pop("late"), case.period_ms, pauses)
    return {
        "rig": figures(real),
        "simulation": figures(simulated),
        "timing": real["timing"],
        "late": late,
        "pauses": {"count": len(pauses), "longest_ms": max(lengths_ms, default=0.0)},
    }


def with_pauses(late: Sequence[dict[str, Any]], period_ms: float, pauses: Sequence[Pause]) -> list[dict[str, Any]]:
    """Return late periods with the longest pause of the machine in each, or in those before that it is late after."""
    found: list[dict[str, Any]] = []
    period_ns = round(1e6 * period_ms)
    began_ns = ended_ns = 0
    for one in late:
        due_ns = one["deadline_ns"]
        began_ns = began_ns if due_ns - period_ns < ended_ns else due_ns - period_ns
        ended_ns = due_ns + round(1e6 * one["late_ms"])
        paused_ns = max((pause.within_ns(began_ns, ended_ns) for pause in pauses), default=0)
        found.append({**one, "paused_ms": paused_ns / 1e6})
    return found


def late_unpaused(measured: dict[str, Any]) -> int:
    """Return how many periods were late by more than the machine had paused in them."""
    return sum(one["late_ms"] > one["paused_ms"] for one in measured["late"])


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


def table(results: dict[str, Any]) -> str:
    """Return the figures of all rigs as a table in Markdown."""
    rows = [
        "| rig | inserted | mean force, mN | in the simulation, mN | largest, mN | late periods | "
        "in this run and those before | late though the machine did not pause | its pauses, the longest | "
        "sensors to commands, ms: p50, p99, max |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name, measured in results.items():
        rig, simulation, timing = measured["rig"], measured["simulation"], measured["timing"]
        forces = [f"{of['mean_force_mN']:.2f} ± {of['standard_error_mN']:.2f}" for of in (rig, simulation)]
        latencies = ", ".join(f"{timing['latency_ms'][key]:.1f}" for key in ("p50", "p99", "max"))
        cells = (
            name,
            f"{rig['inserted']} of {len(rig['episodes'])}",
            *forces,
            f"{rig['max_force_mN']:.0f}, {simulation['max_force_mN']:.0f} simulated",
            f"{timing['overruns']} of {timing['periods']}",
            ", ".join(str(run["late"]) for run in reversed(measured["late_in_runs"])),
            f"{late_unpaused(measured)}",
            f"{measured['pauses']['count']}, {measured['pauses']['longest_ms']:.0f} ms",
            latencies,
        )
        rows.append(f"| {' | '.join(cells)} |")
    return "\n".join(rows)


def into_page(text: str, content: dict[str, Any]) -> str:
    """Return a page with its table replaced."""
    return between(text, START, END, table(content["rigs"]))


def main() -> None:
    """Measure, write and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--episodes", type=int, default=EPISODES)
    parser.add_argument("--rig", choices=[*CASES], action="append", help="only this one; may be repeated")
    parser.add_argument("--table", action="store_true", help="measure nothing, and write the table of the last time")
    arguments = parser.parse_args()
    if arguments.table:
        PAGE.write_text(into_page(PAGE.read_text(), json.loads(RESULTS.read_text())))
        return
    results: dict[str, Any] = json.loads(RESULTS.read_text())["rigs"] if RESULTS.exists() else {}
    missed = []
    for name in arguments.rig or CASES:
        before = results.get(name, {}).get("late_in_runs", [])
        measured = results[name] = measure(CASES[name], arguments.episodes)
        today = {"date": time.strftime("%Y-%m-%d"), "late": measured["timing"]["overruns"]}
        measured["late_in_runs"] = [*before, today]
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
        for one in measured["late"]:
            print(
                f"  {one['late_ms']:.1f} ms late, in a period with a pause of the machine of {one['paused_ms']:.1f} ms"
            )
        pauses = measured["pauses"]
        print(f"{name}: the machine paused {pauses['count']} times, for {pauses['longest_ms']:.1f} ms at most")
        missed += misses(name, measured, arguments.episodes)
        if arguments.episodes >= EPISODES:
            results = {name: results[name] for name in CASES if name in results}
            content = {"machine": machine(), "rigs": results}
            RESULTS.write_text(json.dumps(content, indent=2) + "\n")
            PAGE.write_text(into_page(PAGE.read_text(), content))
    for miss in missed:
        print(f"MISSED {miss}")
    sys.exit(1 if missed else 0)


if __name__ == "__main__":
    main()
