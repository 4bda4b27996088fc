"""The figures of virtual rigs that the documentation shows are those that were measured."""

import json
import runpy
from pathlib import Path

PROJECT = Path(__file__).parents[1]
FOLDER = PROJECT / "benchmarks" / "hardware"
INSERTIONS = runpy.run_path(str(FOLDER / "insertions.py"))
RIGS = json.loads((FOLDER / "insertions.json").read_text())["rigs"]


def test_the_page_shows_the_insertions_that_were_measured() -> None:
    page = INSERTIONS["PAGE"].read_text()
    assert INSERTIONS["into_page"](page, RIGS) == page


def test_every_rig_was_measured_as_often_as_is_wanted_and_nothing_was_missed() -> None:
    assert [*RIGS] == [*INSERTIONS["CASES"]]
    for name, measured in RIGS.items():
        episodes = [episode["seed"] for episode in measured["rig"]["episodes"]]
        assert episodes == [*range(INSERTIONS["EPISODES"])]
        assert [episode["seed"] for episode in measured["simulation"]["episodes"]] == episodes
        assert INSERTIONS["misses"](name, measured, len(episodes)) == []
