"""The figures of virtual rigs that the documentation shows are those that were measured."""

import json
import runpy
from pathlib import Path
from typing import Any

import pytest

FOLDER = Path(__file__).parents[1] / "benchmarks" / "hardware"


def read(name: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return a benchmark and what it measured."""
    return runpy.run_path(str(FOLDER / f"{name}.py")), json.loads((FOLDER / f"{name}.json").read_text())


@pytest.mark.parametrize("name", ["insertions", "fault_matrix", "killed_process"])
def test_the_page_shows_what_was_measured(name: str) -> None:
    benchmark, measured = read(name)
    page = benchmark["PAGE"].read_text(encoding="utf-8")
    assert benchmark["into_page"](page, measured) == page


def test_every_rig_inserts_as_often_as_is_wanted() -> None:
    benchmark, measured = read("insertions")
    assert [*measured["rigs"]] == [*benchmark["CASES"]]
    for name, rig in measured["rigs"].items():
        for kind in ("rig", "simulation"):
            assert [episode["seed"] for episode in rig[kind]["episodes"]] == [*range(benchmark["EPISODES"])]
        assert benchmark["misses"](name, rig, benchmark["EPISODES"]) == []


def test_every_fault_was_thrown_and_led_to_what_it_must() -> None:
    benchmark, measured = read("fault_matrix")
    assert {one["case"]: one["failures"] for one in measured["cases"]} == {
        case.name: [] for case in benchmark["cases"]()
    }


def test_every_killed_process_left_one_command_at_most() -> None:
    _, measured = read("killed_process")
    assert len(measured["deaths"]) >= 20
    assert not any(death["misses"] for death in measured["deaths"])
