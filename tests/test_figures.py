"""The published figures are those of the present files, and what measures them sees what it should."""

import json
import runpy
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from neurorobo.config.experiment import load_experiment
from neurorobo.experiment.build import build_brain, build_task
from neurorobo.experiment.recorder import Setting

PROJECT = Path(__file__).parents[1]
FOLDER = PROJECT / "benchmarks" / "assembly"
FIGURES = runpy.run_path(str(FOLDER / "figures.py"))
PATHS = PROJECT / "benchmarks" / "paradigms"
LATEST = json.loads((FOLDER / "latest.json").read_text())["rows"]


def test_the_readme_shows_the_latest_figures() -> None:
    readme = (PROJECT / "README.md").read_text()
    assert FIGURES["into_readme"](readme, LATEST) == readme


def test_every_row_has_figures() -> None:
    assert [published["name"] for published in LATEST] == [row.name for row in FIGURES["ROWS"]]


@pytest.mark.parametrize("index", range(len(FIGURES["ROWS"])), ids=[row.name for row in FIGURES["ROWS"]])
def test_the_figures_belong_to_the_present_files(index: int) -> None:
    """Where this fails, measure anew: `python benchmarks/assembly/figures.py --only NAME`."""
    row, published = FIGURES["ROWS"][index], LATEST[index]
    experiment = row.experiment()
    assert published["weights_sha256"] == FIGURES["fingerprints"](experiment)
    assert published["config_hash"] == experiment.config_hash
    assert published["wanted"] == row.wanted


def test_a_baseline_that_is_better_than_it_can_be_is_a_miss_too() -> None:
    (row,) = (published for published in LATEST if published["name"].startswith("baseline, model-based"))
    assert FIGURES["misses"](row) == []
    for factor in (0.8, 1.2):
        mean = {"mean": factor * row["figures"]["mean_force_mN"]["mean"]}
        (miss,) = FIGURES["misses"]({**row, "figures": {**row["figures"], "mean_force_mN": mean}})
        assert miss.startswith("mean_force_mN")


def test_interventions_are_counted_for_every_actuator_and_when_they_happen() -> None:
    """Three runs: in one a speed is cut twice, in one a move, in one nothing."""
    experiment = FIGURES["ROWS"][-1].experiment()
    setting = Setting(Path(), "test", build_brain(experiment).plan, range(3), build_task(experiment))
    recorder = FIGURES["Interventions"](setting)

    def tick(left_um: float, speeds: list[int], moves: list[int]) -> None:
        counts = {"axial_speed": np.array(speeds), "radial_move": np.array(moves)}
        recorder.sample(SimpleNamespace(observation={"remaining": np.full((3, 1), left_um)}, interventions=counts))

    tick(100.0, [1, 0, 0], [0, 1, 0])
    tick(40.0, [1, 0, 0], [0, 0, 0])
    assert recorder.all.tolist() == [2, 1, 0]
    assert recorder.early.tolist() == [1, 1, 0]


def test_the_page_on_path_memory_shows_the_latest_figures() -> None:
    """Where this fails, measure anew: `python benchmarks/paradigms/path_memory.py`."""
    benchmark = runpy.run_path(str(PATHS / "path_memory.py"))
    result, page = json.loads((PATHS / "path_memory.json").read_text()), benchmark["PAGE"].read_text()
    assert benchmark["into_page"](page, result) == page
    assert {group: [*labels] for group, labels in result["groups"].items()} == {
        group: [*labels] for group, labels in benchmark["GROUPS"].items()
    }
    assert result["config_hash"] == load_experiment(benchmark["EXAMPLE"]).config_hash
