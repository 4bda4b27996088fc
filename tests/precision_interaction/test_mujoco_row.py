"""The row of MuJoCo's rig: it judges what it shows, and draws it."""

import copy
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from precision_interaction.reproduce.mujoco_rig import IDENTIFICATION, SHIPPED, TEACHERS_RUN, TRAINED, MujocoInsertion
from precision_interaction.reproduce.pages.every import pages
from precision_interaction.reproduce.pages.mujoco_rig import PAGE
from precision_interaction.reproduce.row import Setting
from precision_interaction.reproduce.store import as_json

from tests.precision_interaction.shown import shown

SETTING = Setting(Path(__file__).parents[2] / "examples", quick=True)

pytestmark = pytest.mark.skipif(find_spec("mujoco") is None, reason="the extra `mujoco` is not installed")


@pytest.fixture(scope="module")
def measured() -> dict[str, Any]:
    row = MujocoInsertion()
    return {cell: dict(as_json(row.measure(cell, SETTING))) for cell in row.cells(SETTING)}


def test_it_has_a_page() -> None:
    assert PAGE in pages()


def test_the_teachers_and_the_shipped_brain_insert_and_the_rig_is_as_stiff_as_the_brain_counts_on(
    measured: dict[str, Any],
) -> None:
    for cell in (TEACHERS_RUN, SHIPPED):
        assert measured[cell]["success"] == [1.0, 1.0]
    assert measured[IDENTIFICATION]["stiffness_mN_um"]["mean"] == pytest.approx([80, 80], rel=0.05)


def test_everything_is_shown_and_drawn(measured: dict[str, Any], tmp_path: Path) -> None:
    shown(PAGE, measured, SETTING, tmp_path)


def test_what_is_missed_is_noted(measured: dict[str, Any]) -> None:
    good = copy.deepcopy(measured)
    good[IDENTIFICATION]["contact"] = good[IDENTIFICATION]["in_the_file"]
    good[TRAINED] = dict(good[TEACHERS_RUN])
    assert PAGE.present(good, SETTING).misses == []
    for cell, key, value, miss in (
        (IDENTIFICATION, "contact", {"law": "other"}, "not what is identified"),
        (TRAINED, "success", [1.0, 0.0], "does not insert with every seed"),
        (TRAINED, "final_error_um", [0.0, 1.5], "largest final error"),
        (TRAINED, "mean_force_mN", [1.31 * force for force in good[TEACHERS_RUN]["mean_force_mN"]], "mean force"),
    ):
        bad = copy.deepcopy(good)
        bad[cell][key] = value
        (noted,) = PAGE.present(bad, SETTING).misses
        assert miss in noted
