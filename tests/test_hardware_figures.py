"""The figures of virtual rigs that the documentation shows are those that were measured."""

import json
import runpy
import time
from pathlib import Path
from typing import Any

import pytest
from pauses import Pause, pauses_of_the_machine

FOLDER = Path(__file__).parents[1] / "benchmarks" / "hardware"


def read(name: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return a benchmark and what it measured."""
    return runpy.run_path(str(FOLDER / f"{name}.py")), json.loads((FOLDER / f"{name}.json").read_text())


@pytest.mark.parametrize("name", ["insertions", "fault_matrix", "killed_process", "driver_cost"])
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
        missed = benchmark["misses"](name, rig, benchmark["EPISODES"])
        assert not [miss for miss in missed if "periods were late" not in miss]
        assert bool(missed) == (rig["timing"]["overruns"] > 0)
        assert rig["late_in_runs"][-1]["late"] == rig["timing"]["overruns"] == len(rig["late"])
        assert benchmark["late_unpaused"](rig) == 0


def test_every_fault_was_thrown_and_led_to_what_it_must() -> None:
    benchmark, measured = read("fault_matrix")
    assert {one["case"]: one["failures"] for one in measured["cases"]} == {
        case.name: [] for case in benchmark["cases"]()
    }


def test_every_killed_process_left_one_command_at_most() -> None:
    _, measured = read("killed_process")
    assert len(measured["deaths"]) >= 20
    assert not any(death["misses"] for death in measured["deaths"])


def test_no_driver_costs_more_than_is_wanted() -> None:
    benchmark, measured = read("driver_cost")
    assert len(measured["controllers"]) == 4
    assert all(benchmark["Cost"](**one).share <= benchmark["MOST"] for one in measured["controllers"])


def test_a_late_period_is_explained_by_a_pause_as_long_and_by_nothing_else() -> None:
    benchmark = runpy.run_path(str(FOLDER / "insertions.py"))
    pauses = [Pause(110_000_000, 150_000_000)]

    def explained(deadline_ms: float, *late_ms: float) -> list[bool]:
        """Of periods of 50 ms, one after the other, the first of which is due then."""
        dues_ns = [round(1e6 * (deadline_ms + 50 * index)) for index in range(len(late_ms))]
        late = [{"deadline_ns": due_ns, "late_ms": ms} for due_ns, ms in zip(dues_ns, late_ms, strict=True)]
        found = benchmark["with_pauses"](late, 50.0, pauses)
        return [benchmark["late_unpaused"]({"late": [one]}) == 0 for one in found]

    assert explained(140, 30) == [True]
    assert explained(140, 41) == [False]
    assert explained(140, 35, 3) == [True, True]  # the second is late as the first was
    assert explained(400, 1) == [False]
    assert explained(50, 1) == [False]


def test_the_machine_is_watched_until_the_end() -> None:
    """Whether it pauses meanwhile, nobody can say."""
    with pauses_of_the_machine() as pauses:
        began_ns = time.monotonic_ns()
        time.sleep(0.05)
        ended_ns = time.monotonic_ns()
    assert all(began_ns - 1e9 < pause.began_ns < pause.ended_ns < ended_ns + 1e9 for pause in pauses)
