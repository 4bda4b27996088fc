"""The time of one control period of the whole brain, and of a whole run from the command line.

Run ``python benchmarks/latency/control_period.py`` (a minute, on an otherwise idle machine). One control period is
three imagined steps, plan, approach, expectation and action of ``examples/peg_in_hole.yaml``, batch 1, codes and
command layer included.
"""

import statistics
import subprocess
import sys
import time
from itertools import pairwise
from pathlib import Path

import torch

from neurorobo.config.experiment import load_experiment
from neurorobo.experiment.build import build_brain, build_task
from neurorobo.experiment.closed_loop import run_episodes

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "peg_in_hole.yaml"
WANTED_PERIOD_MS, WANTED_RUN_S = 50.0, 15.0


def main() -> int:
    """Measure and print; return 1 if a wanted figure is missed."""
    experiment = load_experiment(EXAMPLE)
    brain, task = build_brain(experiment), build_task(experiment)
    median_ms = 0.0
    moments: list[float] = []
    for threads in (1, 2):
        torch.set_num_threads(threads)
        for seed in (1000, 1001):  # the first one warms up
            moments.clear()
            run_episodes(brain, task, [seed], progress=lambda tick, running: moments.append(time.perf_counter()))
        periods_ms = [1e3 * (after - before) for before, after in pairwise(moments)]
        median_ms, worst_ms = statistics.median(periods_ms), max(periods_ms)
        print(
            f"control period  {threads} thread{'s' if threads > 1 else ''}: median {median_ms:.1f} ms, "
            f"largest {worst_ms:.1f} ms of {len(periods_ms)} (wanted {WANTED_PERIOD_MS:g} on 2 cores)"
        )

    started = time.perf_counter()
    folder = Path("runs") / "latency" / time.strftime("%Y%m%d-%H%M%S")
    command = [str(Path(sys.executable).with_name("neurorobo")), "run", str(EXAMPLE), "--out", str(folder)]
    subprocess.run(command, check=True, capture_output=True)
    run_s = time.perf_counter() - started
    print(
        f"one episode     {run_s:.1f} s from the command line, start-up and recording included "
        f"(wanted {WANTED_RUN_S:g})"
    )
    return int(median_ms > WANTED_PERIOD_MS or run_s > WANTED_RUN_S)


if __name__ == "__main__":
    sys.exit(main())
