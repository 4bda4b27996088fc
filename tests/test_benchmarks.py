"""Every script of the project can be imported; to run them all would take hours."""

import runpy
from pathlib import Path

import pytest

PROJECT = Path(__file__).parents[1]
SCRIPTS = sorted([*PROJECT.glob("benchmarks/*/*.py"), *PROJECT.glob("plugins/*/tools/*.py")])


def test_there_are_scripts() -> None:
    assert SCRIPTS


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: str(path.relative_to(PROJECT)))
def test_a_script_can_be_imported(script: Path) -> None:
    assert callable(runpy.run_path(str(script))["main"])
