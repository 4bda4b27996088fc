"""The command `measure`."""

import json
from pathlib import Path

import pytest

from tests.cli.test_commands import call

EXAMPLE = str(Path(__file__).parents[2] / "examples" / "minimal.yaml")


def test_it_prints_tables_or_json(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    code, printed, _ = call(capsys, monkeypatch, "measure", EXAMPLE, "--json", "--episodes", "2", "--seed", "5")
    found = json.loads(printed)
    assert (code, found["seeds"], found["control_periods"]) == (0, [5, 6], 40)
    ping = found["regions"]["ping"]
    assert ping["parameter_count"] == 20 * 20
    assert ping["dense"] == 20 * 20 * 50
    assert list(ping["uses"]) == ["ask"]
    code, shown, _ = call(capsys, monkeypatch, "measure", EXAMPLE, "--episodes", "2", "--seed", "5")
    assert code == 0
    assert "of 40 in 2 episodes" in shown
    (row,) = (line for line in shown.splitlines() if "  ask " in line)
    assert [cell.strip() for cell in row.strip("│").split("│")] == [
        "ask",
        "1",
        f"{ping['activation_sparsity']:.4f}",
        f"{ping['effective_acs'] / 1e3:.4g} k",
        "0",
        "20 k",
    ]


def test_a_region_of_which_nothing_is_counted_is_noted(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    example = str(Path(EXAMPLE).with_name("peg_in_hole_teachers.yaml"))
    short = [f"--set={key}=150 um" for key in ("body.length", "regions.gap.length")]
    code, shown, _ = call(capsys, monkeypatch, "measure", example, *short)
    assert code == 0
    assert "not counted in cerebellum: what it computes, as it has no spiking layers" in shown
