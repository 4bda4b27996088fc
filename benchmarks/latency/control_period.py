"""The time of one control period of the whole brain, alone and side by side with others, and of starting up.

Run ``python benchmarks/latency/control_period.py`` (four minutes, on an otherwise idle machine; ``--quick`` only tries
whether it works). It writes ``latest.json`` beside itself and a copy by version into ``benchmarks/history``, prints
what is measured and wanted, and exits with 1 if a figure is missed.

All is of ``examples/peg_in_hole.yaml`` on one thread. A control period is all that the closed loop does between two
ticks: sensors, three imagined steps, plan, approach, expectation and action with their codes, command layer, and the
simulated rig. *Scheduler and codes* are the part of it that `Brain.tick` spends outside of `Region.step`; no region of
this brain encodes or decodes by itself. *Start-up* is from starting the process of ``neurorobo run`` to its first tick.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import torch

import neurorobo
from neurorobo.config.experiment import load_experiment
from neurorobo.engine import engine_path
from neurorobo.experiment.build import build_brain, build_task
from neurorobo.experiment.closed_loop import LARGEST_BATCH, run_episodes
from neurorobo.experiment.recorder import Setting
from neurorobo.plugins import Registry

sys.path.append(str(Path(__file__).resolve().parents[1]))
from machine import machine

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "examples" / "peg_in_hole.yaml"
LATEST = Path(__file__).with_name("latest.json")
HISTORY = ROOT / "benchmarks" / "history"
FIRST_SEED = 1000
SIDE_BY_SIDE, FIRST_PERIODS = 256, 10
"""How many insertions are run side by side, and for how many periods: all of them would take long."""

FIRST_TICK = """
import os, sys, time
from neurorobo.cli.main import main
from neurorobo.graph.brain import Brain

def tick(*_):
    print(time.monotonic(), flush=True)
    os._exit(0)

Brain.tick = tick
sys.argv = ["neurorobo", "run", *sys.argv[1:]]
main()
"""
"""What ``neurorobo run`` does until its first tick, which says when it came."""


@dataclass(frozen=True)
class Figure:
    """One figure, and the most or the least of it that is wanted."""

    name: str
    measured: float
    unit: str
    most: float | None = None
    least: float | None = None

    @property
    def missed(self) -> bool:
        """Whether it is not as wanted."""
        return (self.most is not None and self.measured > self.most) or (
            self.least is not None and self.measured < self.least
        )

    def __str__(self) -> str:
        wanted = f"at most {self.most:g}" if self.most is not None else f"at least {self.least:g}"
        return f"{self.name:44} {self.measured:8.3g} {self.unit:6} wanted {wanted}{'  MISSED' if self.missed else ''}"


class Rig:
    """The example's brain, its task and its recorders, ready to be timed."""

    def __init__(self) -> None:
        self.experiment = load_experiment(EXAMPLE)
        self.brain, self.task = build_brain(self.experiment), build_task(self.experiment)
        self.recorders = [Registry.discover().get("recorder", name) for name in self.experiment.record]

    def periods_ms(self, seeds: Sequence[int], *, recorded: bool = False, periods: int | None = None) -> list[float]:
        """Return the times of all, or the first, control periods of insertions side by side, from tick to tick."""
        moments: list[float] = []
        setting = Setting(Path(), self.experiment.name, self.brain.plan, seeds, self.task)
        run_episodes(
            self.brain,
            self.task,
            seeds,
            duration_ns=None if periods is None else (periods + 1) * self.brain.plan.clock.tick_ns,
            recorders=[recorder(setting) for recorder in self.recorders] if recorded else (),
            progress=lambda tick, running: moments.append(time.perf_counter()),
        )
        return [1e3 * (after - before) for before, after in pairwise(moments)]

    def share_outside(self, seed: int) -> float:
        """Return which share of a mean control period `Brain.tick` spends outside of `Region.step`."""
        regions = [self.brain.region(name) for name in self.brain.names]
        spent_s = {"tick": 0.0, "step": 0.0}

        def timed(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
            def run(*arguments: Any) -> Any:
                started = time.perf_counter()
                result = function(*arguments)
                spent_s[name] += time.perf_counter() - started
                return result

            return run

        with ExitStack() as stack:
            stack.enter_context(mock.patch.object(self.brain, "tick", timed("tick", self.brain.tick)))
            for region in regions:
                stack.enter_context(mock.patch.object(region, "step", timed("step", region.step)))
            periods_ms = self.periods_ms([seed])
        ticks = len(periods_ms) + 1  # the last one is followed by none
        return 1e3 * (spent_s["tick"] - spent_s["step"]) / ticks / statistics.mean(periods_ms)


def alone(rig: Rig, episodes: int) -> list[Figure]:
    """Return the figures of one insertion at a time: plain, recorded, and timed inside, by turns."""
    periods_ms: dict[bool, list[float]] = {False: [], True: []}
    shares = []
    rig.periods_ms([FIRST_SEED])  # warms up
    for seed in range(FIRST_SEED, FIRST_SEED + episodes):
        for recorded, found in periods_ms.items():
            found += rig.periods_ms([seed], recorded=recorded)
        shares.append(rig.share_outside(seed))
    plain, recorded_ms = (statistics.median(found) for found in periods_ms.values())
    worst_ms = float(np.percentile(periods_ms[False], 99))
    return [
        Figure(f"control period, median of {len(periods_ms[False])}", plain, "ms", most=10),
        Figure("its 99th percentile over its median", worst_ms / plain, "times", most=1.5),
        Figure("scheduler and codes, of the period", 100 * statistics.median(shares), "%", most=10),
        Figure("a period with recording, longer by", 100 * (recorded_ms / plain - 1), "%", most=5),
    ]


def side_by_side(rig: Rig, runs: int) -> dict[str, float]:
    """Return periods per second of one insertion at a time, and of many, counted for each of them.

    ``side_by_side`` is how `neurorobo run` takes many: so many at once as stay in the cache, one group after the other.
    ``in_lockstep`` is all of them at once.
    """
    seeds = range(FIRST_SEED, FIRST_SEED + runs)

    def alone_ms() -> list[float]:
        return [ms for seed in seeds[:5] for ms in rig.periods_ms([seed], periods=FIRST_PERIODS)]

    alone_ms()  # warms up
    before_ms = alone_ms()
    groups = [seeds[first : first + LARGEST_BATCH] for first in range(0, runs, LARGEST_BATCH)]
    groups_ms = sum(statistics.median(rig.periods_ms(group, periods=FIRST_PERIODS)) for group in groups)
    all_ms = statistics.median(rig.periods_ms(seeds, periods=FIRST_PERIODS))
    single_ms = statistics.median(before_ms + alone_ms())  # before and after, if the machine drifts
    return {"alone": 1e3 / single_ms, "side_by_side": 1e3 * runs / groups_ms, "in_lockstep": 1e3 * runs / all_ms}


def of_path(path: str, runs: int) -> dict[str, float]:
    """Return what :func:`side_by_side` does on a path of the engine, in a process of its own."""
    command = [sys.executable, __file__, "--side-by-side", str(runs)]
    done = subprocess.run(
        command, check=True, stdout=subprocess.PIPE, env={**os.environ, "NEUROROBO_ENGINE": path}, text=True
    )
    found: dict[str, float] = json.loads(done.stdout)
    return found


def start_up_s() -> float:
    """Return the seconds from starting the process of a run to its first tick."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-c", FIRST_TICK, str(EXAMPLE), "--out", f"{folder}/run"]
        started = time.monotonic()  # the same clock in all processes
        done = subprocess.run(command, check=True, capture_output=True, text=True)
    return float(done.stdout) - started


def measured(episodes: int, runs: int, starts: int, rates: dict[str, dict[str, float]]) -> Iterator[Figure]:
    """Yield all figures; ``rates`` gets the periods per second of each path."""
    yield from alone(Rig(), episodes)
    for path, wanted in (("native", 1.2), ("portable", 1.7)):
        if path == "native" and engine_path().name != "native":
            print(f"native is left out: {engine_path().reason}")
            continue
        rates[path] = found = of_path(path, runs)
        gain = found["side_by_side"] / found["alone"]
        yield Figure(f"{path}: periods/s of {runs} side by side to alone", gain, "times", least=wanted)
    start_s = statistics.median(start_up_s() for _ in range(starts))
    yield Figure(f"start-up to the first period, median of {starts}", start_s, "s", most=4)


def main() -> int:
    """Measure, write and print; return 1 if a wanted figure is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="few periods; writes nothing, and the times mean nothing")
    parser.add_argument("--side-by-side", type=int, metavar="RUNS", help="measure and print only this, as JSON")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    if arguments.side_by_side:
        print(json.dumps(side_by_side(Rig(), arguments.side_by_side)))
        return 0
    about, figures = machine(), []
    rates: dict[str, dict[str, float]] = {}
    for figure in measured(*((1, 2, 1) if arguments.quick else (20, SIDE_BY_SIDE, 5)), rates):
        print(figure, flush=True)
        figures.append(figure)
    for path, found in rates.items():
        print(f"{path}, periods/s: " + ", ".join(f"{rate:.0f} {how.replace('_', ' ')}" for how, rate in found.items()))
    if arguments.quick:
        return 0
    content = {
        "version": neurorobo.__version__,
        "machine": about,
        "figures": [{**asdict(figure), "missed": figure.missed} for figure in figures],
        "periods_per_s": rates,
    }
    HISTORY.mkdir(exist_ok=True)
    for file in (LATEST, HISTORY / f"latency-{neurorobo.__version__}.json"):
        file.write_text(json.dumps(content, indent=2) + "\n")
    return int(any(figure.missed for figure in figures))


if __name__ == "__main__":
    sys.exit(main())
