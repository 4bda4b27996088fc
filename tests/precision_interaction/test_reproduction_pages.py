"""The published report says what the published results do."""

import json
from pathlib import Path

import pytest
from precision_interaction.reproduce.pages.every import pages
from precision_interaction.reproduce.pages.page import Page
from precision_interaction.reproduce.pages.report import write_report
from precision_interaction.reproduce.row import Setting
from precision_interaction.reproduce.store import Store

ROOT = Path(__file__).parents[2]
PUBLISHED = ROOT / "docs" / "reproduction"
COMMAND = "neurorobo reproduce --out docs/reproduction"
SETTING = Setting(ROOT / "examples")

published = [page for page in pages() if (PUBLISHED / "results" / f"{page.row.name}.json").exists()]


def test_the_pages_are_made_of_the_results(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    assert published
    rows = [(page, Store(PUBLISHED / "results", page.row, SETTING)) for page in published]
    assert all(store.whole for _, store in rows)
    write_report(tmp_path, rows, SETTING, COMMAND)
    assert (tmp_path / "index.md").read_text() == (PUBLISHED / "index.md").read_text()
    drawn = {file.name for file in (tmp_path / "figures").iterdir()}
    assert drawn == {file.name for file in (PUBLISHED / "figures").iterdir()}


@pytest.mark.parametrize("page", published, ids=lambda page: page.row.name)
def test_every_cell_was_measured_by_a_commit(page: Page) -> None:
    kept = json.loads((PUBLISHED / "results" / f"{page.row.name}.json").read_text())["cells"]
    assert set(kept) == set(page.row.cells(SETTING))
    for cell in kept.values():
        assert cell["commit"] != "unknown"


@pytest.mark.parametrize("page", published, ids=lambda page: page.row.name)
def test_the_list_tells_how_long_the_published_results_took(page: Page) -> None:
    """Two cells at a time, each begun where one ends; within a half, as machines and their load differ."""
    kept = json.loads((PUBLISHED / "results" / f"{page.row.name}.json").read_text())["cells"]
    ends = [0.0, 0.0]
    for cell in kept.values():
        ends = [max(ends), min(ends) + cell["seconds"]]
    assert 60 * page.minutes == pytest.approx(max(ends), rel=0.5, abs=5)


@pytest.mark.parametrize("page", published, ids=lambda page: page.row.name)
def test_the_results_are_of_this_code(page: Page) -> None:
    if missing := Store(PUBLISHED / "results", page.row, SETTING).missing():
        pytest.skip(f"{len(missing)} cells are of other code; before a release: {COMMAND} {page.row.name}")
