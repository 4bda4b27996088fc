"""The published report says what the published results do."""

import json
from pathlib import Path

import pytest
from precision_interaction.reproduce.report import write_report
from precision_interaction.reproduce.row import Setting
from precision_interaction.reproduce.rows import rows
from precision_interaction.reproduce.store import Store

ROOT = Path(__file__).parents[2]
PUBLISHED = ROOT / "docs" / "reproduction"
COMMAND = "neurorobo reproduce --out docs/reproduction"
SETTING = Setting(ROOT / "examples")

published = [row for row in rows() if (PUBLISHED / "results" / f"{row.name}.json").exists()]


def test_the_pages_are_made_of_the_results(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    assert published
    stores = [Store(PUBLISHED / "results", row, SETTING) for row in published]
    write_report(tmp_path, stores, SETTING, COMMAND)
    assert (tmp_path / "index.md").read_text() == (PUBLISHED / "index.md").read_text()
    drawn = {file.name for file in (tmp_path / "figures").iterdir()}
    assert drawn == {file.name for file in (PUBLISHED / "figures").iterdir()}


@pytest.mark.parametrize("row", published, ids=lambda row: row.name)
def test_every_cell_was_measured_by_a_commit(row) -> None:  # type: ignore[no-untyped-def]
    kept = json.loads((PUBLISHED / "results" / f"{row.name}.json").read_text())["cells"]
    assert set(kept) == set(row.cells(SETTING))
    for cell in kept.values():
        assert cell["commit"] != "unknown"


@pytest.mark.parametrize("row", published, ids=lambda row: row.name)
def test_the_results_are_of_this_code(row) -> None:  # type: ignore[no-untyped-def]
    if missing := Store(PUBLISHED / "results", row, SETTING).missing():
        pytest.skip(f"{len(missing)} cells are of other code; before a release: {COMMAND} {row.name}")
