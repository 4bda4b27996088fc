"""A control loop runs on one thread, so that a busy neighbour on the machine costs it little."""

import os
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import torch

from neurorobo.config.experiment import load_experiment
from neurorobo.experiment.build import build_brain

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "peg_in_hole.yaml"


@contextmanager
def busy_neighbour() -> Iterator[None]:
    """Let another process compute all the time, as a training beside a robot does."""
    process = subprocess.Popen([sys.executable, "-c", "while True: pass"])
    try:
        yield
    finally:
        process.kill()
        process.wait()


@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="with one core, a neighbour takes half of it")
def test_a_busy_neighbour_does_not_multiply_the_latency() -> None:
    brain = build_brain(load_experiment(EXAMPLE))
    observation = {"force": torch.tensor([[3.0, 4.0]]), "remaining": torch.tensor([[1500.0]])}

    def median_s(periods: int = 15) -> float:
        state, times = brain.init_state([1000]), []
        for _ in range(periods):
            started = time.perf_counter()
            _, state = brain.tick(observation, state)
            times.append(time.perf_counter() - started)
        return statistics.median(times)

    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # as `neurorobo run` does
    try:
        with torch.inference_mode():
            median_s()
            alone, crowded = [], []
            for _ in range(8):
                alone.append(median_s())
                with busy_neighbour():
                    crowded.append(median_s())
    finally:
        torch.set_num_threads(threads)
    # Twice is what a fair share of a full machine costs; threads that wait for each other cost fifty times as much.
    assert min(crowded) < 4 * min(alone)
