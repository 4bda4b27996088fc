"""The tool that ships weights: fixed point that loads again, and cards that tell how the weights came about."""

import json
import runpy
from pathlib import Path
from typing import Any

import pytest
import torch

from neurorobo.config.experiment import Experiment, load_experiment
from neurorobo.errors import NeuroroboError
from neurorobo.experiment.lessons import Lesson, read_lessons
from neurorobo.experiment.train import train_experiment
from neurorobo.plugins import Registry
from neurorobo.regions.weights import GRID_BITS

PROJECT = Path(__file__).parents[2]
EXAMPLE = PROJECT / "examples" / "peg_in_hole.yaml"
PHASES = len(load_experiment(EXAMPLE).train)
NAME = "prefrontal_cortex"
SMALL = [
    f"regions.{NAME}={{type: precision.{NAME}, hidden_neurons: [16, 16], general_neurons: 16}}",
    *(f"train.{index}.{change}" for index in range(PHASES) for change in ("steps=1", "batch=2")),
]


@pytest.fixture(scope="module")
def tool() -> dict[str, Any]:
    return runpy.run_path(str(PROJECT / "plugins" / "precision_interaction" / "tools" / "ship.py"))


def read(*more: str) -> tuple[Experiment, list[Lesson]]:
    registry = Registry.discover()
    experiment = load_experiment(EXAMPLE, [*SMALL, *more], registry)
    return experiment, [lesson for lesson in read_lessons(experiment, registry) if NAME in lesson.phase.pupils]


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("trained")
    experiment, _ = read()
    train_experiment(experiment, read_lessons(experiment, Registry.discover()), folder, only=[NAME])
    return folder


def report(trained: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((trained / "training.json").read_text())
    return found


def test_a_card_holds_every_setting_and_judges_the_shipped_weights_once(
    tool: dict[str, Any], trained: Path, tmp_path: Path
) -> None:
    experiment, lessons = read()
    path = tool["ship"](experiment, NAME, lessons, trained, report(trained), tmp_path)
    card = path.with_suffix(".md").read_text()
    assert f"configuration {experiment.config_hash}" in card
    sections = card.split("## ")[1:-1]
    assert len(sections) == len(lessons)
    for section, lesson in zip(sections, lessons, strict=True):
        for part in (lesson.phase, lesson.teacher, lesson.data):
            for key, value in part.model_dump(mode="json", exclude_none=True).items():
                assert f"{key}:" in section
                if isinstance(value, int | float | str) and not isinstance(value, bool):
                    assert str(value) in section, key
    taught_last = {output: index for index, lesson in enumerate(lessons) for output in lesson.phase.loss}
    for index, (section, lesson) in enumerate(zip(sections, lessons, strict=True)):
        for output in lesson.phase.loss:
            (line,) = (line for line in section.splitlines() if line.startswith(f"| {output} |"))
            cells = [cell.strip() for cell in line.strip("|").split("|")]
            assert all(cells[2:5])
            assert all(cells[5:]) if taught_last[output] == index else not any(cells[5:]), line


def test_weights_that_the_file_does_not_describe_are_not_shipped(
    tool: dict[str, Any], trained: Path, tmp_path: Path
) -> None:
    experiment, lessons = read(f"train.{PHASES - 1}.learning_rate=0.5")
    with pytest.raises(NeuroroboError, match=r"phase\d+_prefrontal_cortex.* trained by other settings"):
        tool["ship"](experiment, NAME, lessons, trained, report(trained), tmp_path)
    assert not list(tmp_path.iterdir())


def test_tensors_fit_sixteen_bits_large_ones_eight_and_their_sums_are_exact(tool: dict[str, Any]) -> None:
    bits, large = tool["fractional_bits"], tool["LARGE"]
    assert bits(torch.zeros(3, 4)) == GRID_BITS
    assert bits(torch.full((3, 4), 1.5)) == 14  # 1.5 * 2**14 is below 2**15
    assert bits(torch.full((large // 1000, 1000), 1.5)) == 6
    assert bits(torch.full((3, 4000), 0.3)) == 11  # 1200 * 2**11 is below 2**22
    assert bits(torch.full((3, 4), 0.001)) == 16
