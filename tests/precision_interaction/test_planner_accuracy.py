"""The prefrontal cortex plans like its teacher wherever it can get, and the published errors are its own."""

import hashlib
import json
import runpy
from pathlib import Path
from typing import Any

import pytest

from neurorobo.config.experiment import Experiment, load_experiment
from neurorobo.experiment.weights import weights_file

PROJECT = Path(__file__).parents[2]
FOLDER = PROJECT / "benchmarks" / "assembly"


@pytest.fixture(scope="module")
def benchmark() -> dict[str, Any]:
    return runpy.run_path(str(FOLDER / "planner_accuracy.py"))


@pytest.fixture(scope="module")
def experiment() -> Experiment:
    return load_experiment(PROJECT / "examples" / "peg_in_hole.yaml")


@pytest.fixture(scope="module")
def measured(benchmark: dict[str, Any], experiment: Experiment) -> dict[str, Any]:
    found: dict[str, Any] = benchmark["measure"](experiment, states=250, seeds=range(1000, 1020))
    return found


def test_the_planned_speed_is_the_teacher_s_everywhere_and_on_the_way(
    benchmark: dict[str, Any], measured: dict[str, Any]
) -> None:
    assert benchmark["misses"](measured) == []


def test_every_bin_and_every_output_is_looked_at(benchmark: dict[str, Any], measured: dict[str, Any]) -> None:
    bins = [f"{nearer}..{further} um" for nearer, further in benchmark["BINS_UM"]]
    assert set(measured) == set(benchmark["WANTED_SPEED_ERROR_UM_S"])
    for rows in measured.values():
        assert list(rows) == bins
        for row in rows.values():
            assert row["states"] > 0
            assert set(benchmark["OUTPUTS"]) < set(row)


def test_a_planner_that_errs_is_reported(benchmark: dict[str, Any]) -> None:
    row = {"states": 1, "speed": {"q90": 99.0}}
    (miss,) = benchmark["misses"]({"uniform": {"0..10 um": row}})
    assert miss.startswith("uniform, 0..10 um")


def test_the_published_errors_belong_to_the_shipped_weights(experiment: Experiment) -> None:
    published = json.loads((FOLDER / "planner_accuracy.json").read_text())
    weights = weights_file("prefrontal_cortex", experiment)
    assert published["weights_sha256"] == hashlib.sha256(weights.read_bytes()).hexdigest(), published["command"]
    assert published["config_hash"] == experiment.config_hash, published["command"]
