"""The row of Fig. 5: its cells, its figures, and how it is shown."""

import json
from pathlib import Path
from typing import Any

import pytest
import torch
from precision_interaction.regions.hippocampus_config import HippocampusConfig
from precision_interaction.reproduce import hippocampus as fig5
from precision_interaction.reproduce.pages import hippocampus as page
from precision_interaction.reproduce.row import Setting

from neurorobo.config.experiment import load_experiment

EXAMPLES = Path(__file__).parents[2] / "examples"
QUICK, FULL = Setting(EXAMPLES, quick=True), Setting(EXAMPLES)


def fabricated(cell: str, error: float) -> dict[str, Any]:
    """A result of a training that was ``error`` off for every period and parameter, ``error`` + 1 before that."""
    errors = [[error] * 4] * fig5.PERIODS
    law = fig5.law_ahead(fig5.SPEEDS_UM_S[fig5.SHOWN], fig5.TRAINED_PERIODS)
    return {
        "rms": errors,
        "rms_in_range": errors,
        "rates": {"hidden": 0.2, "output": 0.1},
        "steps": 100,
        "curve": [[50, 3.0, *[error + 1] * 3], [100, 6.0, *[error] * 3]],
        "expected": (law + error).tolist(),
    }


def test_there_is_a_cell_for_each_network_course_and_seed() -> None:
    cells = fig5.Fig5().cells(FULL)
    assert len(set(cells)) == len(cells) == (2 * 5 + 3) * 5
    for network in fig5.NETWORKS:
        assert {f"{network}; {fig5.LONG}; seed {seed}" for seed in range(5)} <= set(cells)
    assert len(fig5.Fig5().cells(QUICK)) == len(cells) / 5


@pytest.mark.parametrize("network", ["RSNU", "liquid state machine, feedback"])
def test_a_measured_cell_survives_json_and_is_the_same_again(network: str) -> None:
    row, cell = fig5.Fig5(), f"{network}; {fig5.FALLING}; seed 0"
    first, second = (row.measure(cell, QUICK) for _ in range(2))
    assert json.loads(json.dumps(first, allow_nan=False))["steps"] == 6
    for key in ("rms", "rms_in_range", "rates", "expected"):
        assert first[key] == second[key]
    assert torch.tensor(first["rms"]).shape == (fig5.PERIODS, 4)


def test_the_example_is_a_course() -> None:
    phases = fig5._course(fig5.EXAMPLE, FULL)
    assert [phase.unroll.windows for phase in phases] == [1, 2, 3]
    config = load_experiment(EXAMPLES / "peg_in_hole.yaml").regions["hippocampus"]
    assert isinstance(config, HippocampusConfig)
    assert config.surrogate_width == fig5.SURROGATE_WIDTH[fig5.EXAMPLE]


@pytest.mark.parametrize(("network", "windows"), [("RSNU", [1, 1, 1]), (fig5.DOUBLE, [1, 2, 3])])
def test_without_feedback_a_network_is_trained_one_period_ahead_only(
    network: str, windows: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    trained: list[int] = []
    monkeypatch.setattr(fig5, "supervise", lambda *args, **_: trained.append(args[3].unroll.windows))
    data = fig5.InsertionSpeeds(fig5.InsertionSpeedsConfig(), fig5.CLOCK)
    region = fig5.build(fig5.NETWORKS[network], 0)
    fig5.train(region, fig5._course(fig5.FALLING, QUICK), data, 0, (), lambda progress: None)
    assert trained == windows


def test_the_law_adds_up_and_errors_are_root_mean_squares() -> None:
    law = fig5.law_ahead(torch.tensor([10.0, 50.0]), 3)
    torch.testing.assert_close(law[0, 0], torch.tensor([6.18, 10.72, 11.72, 5.35]))
    torch.testing.assert_close(law[2], 3 * law[0])
    errors = torch.tensor([3.0, 4.0]).view(1, 2, 1).expand(1, 2, 4)
    torch.testing.assert_close(fig5.rms(errors), torch.full((1, 4), 12.5**0.5))
    counts = torch.tensor([True, False]).view(1, 2, 1).expand(1, 2, 4)
    torch.testing.assert_close(fig5.rms(errors, counts), torch.full((1, 4), 3.0))


def test_time_to_accuracy_is_when_all_horizons_are_met() -> None:
    curves = [[[50, 3.0, 2.0, 2.0, 9.0], [100, 6.0, 2.0, 2.0, 3.0], [150, 9.0, 2.0, 2.0, 2.0]], [[50, 3.0, 9, 9, 9]]]
    assert page._reached(curves, (2.5, 2.8, 3.1)) == "100 steps, 6 s (1 of 2 seeds)"
    assert page._reached(curves[1:], (2.5, 2.8, 3.1)) == "not (0 of 1 seeds)"


def test_the_presentation_tells_what_is_missed() -> None:
    row = fig5.Fig5()
    good = page.present({cell: fabricated(cell, 1.0) for cell in row.cells(FULL)}, FULL)
    assert not [miss for miss in good.misses if "order" not in miss]
    bad = page.present({cell: fabricated(cell, 9.0) for cell in row.cells(FULL)}, FULL)
    assert sum("wanted at most" in miss for miss in bad.misses) == 9  # three horizons: mean, worst seed, aim
    for table in bad.tables:
        assert all(len(line) == len(table.heads) for line in table.lines)
    assert "9.0" in bad.tables[0].lines[0]


@pytest.mark.filterwarnings("ignore")
def test_the_pictures_can_be_drawn(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    from precision_interaction.reproduce.pages.plotting import save

    row = fig5.Fig5()
    shown = page.present({cell: fabricated(cell, 1.0) for cell in row.cells(QUICK)}, QUICK)
    for picture in shown.pictures:
        assert all(file.stat().st_size for file in save(picture, tmp_path))
