"""The row of adaptation: what is measured is judged and drawn, and a session's insertions follow one another."""

from pathlib import Path
from typing import Any

import numpy as np
from precision_interaction.reproduce.adaptation import (
    METRICS,
    PERIODS_AFTER,
    PERIODS_BEFORE,
    SESSIONS,
    STIFFER,
    TIMED,
    Adaptation,
)
from precision_interaction.reproduce.pages.adaptation import PAGE
from precision_interaction.reproduce.row import Setting
from precision_interaction.reproduce.store import as_json

from tests.precision_interaction.shown import shown

SETTING = Setting(Path(__file__).parents[2] / "examples", quick=True)


def measured() -> dict[str, Any]:
    """Figures of three sessions that miss nothing, made up."""
    results: dict[str, Any] = {}
    for name, session in SESSIONS.items():
        stretches = [
            [{metric: [1.0, 1.0, 1.0] for metric in METRICS} for _ in range(stretch.insertions)]
            for stretch in session.stretches
        ]
        changed = any(STIFFER in stretch.changes for stretch in session.stretches)
        around = (
            (np.linspace(1.0, 1.1, PERIODS_BEFORE + PERIODS_AFTER) + np.arange(3)[:, None] / 100).tolist()
            if changed
            else []
        )
        results[name] = {"stretches": stretches, "around": around}
    results["learning off"] = {"peg_in_hole": {"same": 2, "of": 2}, "peg_in_hole_fast": {"same": 2, "of": 2}}
    results["control period"] = {n: {"planning": 20.0, "others": 9.0, "longest": 30.0} for n in TIMED}
    return results


def test_it_shows_what_is_missed(tmp_path: Path) -> None:
    results = measured()
    assert set(results) == set(Adaptation().cells(SETTING))
    assert shown(PAGE, results, SETTING, tmp_path).misses == []
    results["paper rig, learning"]["stretches"][0][-1]["mean_force_mN"] = [1.2, 1.2, 1.2]
    results["fine rig, learning"]["around"][0][9] = 3.0
    results["fine rig, as shipped"]["stretches"][0][0]["success"][1] = 0.0
    results["learning off"]["peg_in_hole"]["same"] = 1
    results["control period"]["learning"]["planning"] = 60.0
    assert len(PAGE.present(results, SETTING).misses) == 5


def test_the_ideal_controller_is_measured_again_to_the_same() -> None:
    first, second = (Adaptation().measure("fine rig, ideal", SETTING) for _ in range(2))
    assert as_json(first) == as_json(second)
    assert len(first["around"]) == 2
    assert all(np.mean(means[5:]) > 1.1 * np.mean(means[:5]) for means in first["around"])
