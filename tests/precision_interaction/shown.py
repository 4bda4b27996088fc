"""What every page of the reproduction must keep: tables are whole, and pictures can be drawn."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from precision_interaction.reproduce.pages.page import Page, Presentation
from precision_interaction.reproduce.row import Setting


def shown(page: Page, results: Mapping[str, Any], setting: Setting, folder: Path) -> Presentation:
    """Present, check the tables, and draw if there is something to draw with."""
    presentation = page.present(results, setting)
    for table in presentation.tables:
        assert table.lines
        assert all(len(line) == len(table.heads) for line in table.lines)
    pytest.importorskip("matplotlib")
    from precision_interaction.reproduce.pages.plotting import save

    for picture in presentation.pictures:
        for file in save(picture, folder):
            assert file.stat().st_size > 1000
    return presentation
