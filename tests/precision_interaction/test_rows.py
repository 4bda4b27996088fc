"""The rows of contact, additivity, firing rates and codes: they judge what they show, and draw it."""

import copy
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from precision_interaction.reproduce import additivity, firing_rates
from precision_interaction.reproduce.additivity import Additivity
from precision_interaction.reproduce.codes import CODES, SIZES, TRAINED_SIZES, Codes
from precision_interaction.reproduce.contact import Contact
from precision_interaction.reproduce.firing_rates import REGIONS, FiringRates
from precision_interaction.reproduce.learning import REGIONS as PUPILS
from precision_interaction.reproduce.learning import Learning, same_as_shipped
from precision_interaction.reproduce.operations import dense_pJ, spiking_pJ, synapses
from precision_interaction.reproduce.pages.additivity import HOLDS
from precision_interaction.reproduce.pages.every import pages
from precision_interaction.reproduce.pages.page import Page, Presentation
from precision_interaction.reproduce.ppo import DEPTH_GAIN, PAPER_RIG, QUICK_TRAININGS, SEEDED, Ideal, Ppo
from precision_interaction.reproduce.row import Row, Setting
from precision_interaction.reproduce.store import as_json

from neurorobo.config.experiment import load_experiment
from neurorobo.engine import Circuit, Layer
from neurorobo.experiment.weights import weights_file
from neurorobo.neurons import LIF
from neurorobo.synapses import Dense, FanIn
from tests.precision_interaction.shown import shown as shown_by

SETTING = Setting(Path(__file__).parents[2] / "examples", quick=True)
Results = dict[str, dict[str, Any]]


def measured(row: Row) -> Results:
    return {cell: dict(as_json(row.measure(cell, SETTING))) for cell in row.cells(SETTING)}


def page_of(row: Row) -> Page:
    [page] = [page for page in pages() if isinstance(row, type(page.row))]
    return page


def present(row: Row, results: Mapping[str, Any]) -> Presentation:
    return page_of(row).present(results, SETTING)


def shown(row: Row, results: Mapping[str, Any], tmp_path: Path) -> Presentation:
    return shown_by(page_of(row), results, SETTING, tmp_path)


def test_they_are_registered() -> None:
    assert {"contact", "additivity", "rates", "codes"} <= {page.row.name for page in pages()}


def test_contact_is_measured_again_to_the_same(tmp_path: Path) -> None:
    first, second = (Contact().measure("measured", SETTING) for _ in range(2))
    assert as_json(first) == as_json(second)


def test_contact_notes_what_is_missed(tmp_path: Path) -> None:
    results = measured(Contact())
    for found in results.values():
        found["r_squared"] = [[0.99, 0.99] for _ in found["step_um"]]
    good = copy.deepcopy(results)
    results["measured"]["r_squared"][0][1] = 0.9
    results["measured"]["chosen"] = "proportional"
    results["proportional"]["fits"]["proportional"]["mean"]["slope"][0] = 1.0
    misses = shown(Contact(), results, tmp_path).misses
    assert "measured: least R^2 of a Gaussian is 0.9, wanted at least 0.96" in misses
    assert "measured: the log was taken for the other law" in misses
    assert any("mean slope" in miss and "proportional" in miss for miss in misses)
    assert not any("R^2" in miss for miss in present(Contact(), good).misses)


def test_additivity_shows_what_adds_up_and_notes_where_it_should_not(tmp_path: Path) -> None:
    results = measured(Additivity())
    for law, found in results.items():
        for form in additivity.FORMS:
            for one in found[form]:
                one["p"] = 0.5 if HOLDS[law, form] else 0.0
    assert shown(Additivity(), results, tmp_path).misses == []
    results["measured"][additivity.LONGER][3]["p"] = 0.5
    assert present(Additivity(), results).misses == []  # one n that does not add up is enough
    for one in results["measured"][additivity.LONGER]:
        one["p"] = 0.5
    (miss,) = present(Additivity(), results).misses
    assert miss.startswith("measured, one move of n x 20 um")


def test_the_statistic_is_as_large_as_chance_makes_it_and_finds_what_is_not_chance() -> None:
    generator = np.random.default_rng(0)
    factor = np.linalg.cholesky([[4.0, 1.0], [1.0, 2.0]])

    def sample(steps: float, count: int = 3000) -> Any:
        return steps * np.array([3.0, 5.0]) + np.sqrt(steps) * generator.standard_normal((count, 2)) @ factor.T

    tests = [additivity.compare(sample(1), sample(3), 3) for _ in range(200)]
    assert np.mean([test.mean for test in tests]) == pytest.approx(2, abs=0.6)
    assert np.mean([test.covariance for test in tests]) == pytest.approx(3, abs=0.8)
    assert 0.0 <= np.mean([test.p < 0.05 for test in tests]) < 0.12
    assert additivity.compare(sample(1), sample(3.3), 3).p < 1e-6


def test_a_spike_costs_its_fan_out() -> None:
    generator = torch.Generator().manual_seed(0)
    first = Layer([FanIn(6, 10, 2, generator)], LIF())
    second = Layer([Dense(10, 4, generator), Dense(6, 4, generator)], LIF(), recurrent=Dense(4, 4, generator))
    circuit = Circuit(["a", "b"], {"first": (first, [("a", "b")]), "second": (second, ["first", ("a", "b")])})
    ones = {"a": torch.ones(1, 2), "b": torch.ones(1, 4), "first": torch.ones(1, 10), "second": torch.ones(1, 4)}
    found = {one.name: (one.count, one.operations(ones).item()) for one in synapses(circuit)}
    assert found == {
        "first <- a, b": (20, 20),
        "second <- first": (40, 40),
        "second <- a, b": (24, 24),
        "second <- second": (16, 16),
    }
    (of_first, *_) = synapses(circuit)
    twice = {"a": torch.tensor([[2.0, 0.0]]), "b": torch.zeros(1, 4)}
    projection = first.projections[0]
    assert of_first.operations(twice).item() == 2 * (projection.source_index == 0).sum()


def test_energy_is_that_of_its_operations() -> None:
    assert spiking_pJ(10, 0) == pytest.approx(9.0)
    assert spiking_pJ(0, 10) == dense_pJ(10) == pytest.approx(46.0)


def test_rates_are_those_that_a_run_tells_and_nothing_fires_without_a_spike(tmp_path: Path) -> None:
    from neurorobo.experiment.build import build_brain, build_task
    from neurorobo.experiment.closed_loop import run_episodes

    results = measured(FiringRates())
    presentation = shown(FiringRates(), results, tmp_path)
    assert not any("without an input spike" in miss for miss in presentation.misses)
    assert results["at rest"]["hippocampus"]["zero"] == 0
    assert results["at rest"]["cerebellum"]["zero"] > 0

    experiment = load_experiment(SETTING.examples / firing_rates.EXAMPLE)
    episodes = run_episodes(build_brain(experiment), build_task(experiment), range(firing_rates.QUICK_EPISODES))
    for name in REGIONS:
        told = np.mean([episode.firing_rates[name] for episode in episodes])
        assert results["insertions"]["regions"][name]["mean"] == pytest.approx(told, rel=0.05)


def test_a_region_that_fires_too_fast_is_noted(tmp_path: Path) -> None:
    region = {
        "mean": 0.5,
        "deviation": 0.1,
        "deviation_of_windows": 0.1,
        "deviation_of_neurons": 0.1,
        "layers": {"hidden": 0.5},
        "neurons": 10,
        "windows": [0.5] * firing_rates.WINDOWS,
        "histogram": [10, *([0] * (firing_rates.BINS - 1))],
        "uses": 4.0,
        "updates": 2000.0,
        "operations": {"hidden <- speed": 1000.0},
        "synapses": {"hidden <- speed": 50},
    }
    results = {
        "insertions": {"periods": 10, "steps": 50, "regions": dict.fromkeys(REGIONS, region)},
        "at rest": {name: {"no_spikes": 0.0, "zero": 0.1} for name in REGIONS},
    }
    (miss,) = shown(FiringRates(), results, tmp_path).misses
    assert miss == "mean firing rate of the three regions is 0.5, wanted at most 0.2"


def test_codes_are_judged_by_their_repeatability_and_their_stated_resolution(tmp_path: Path) -> None:
    trip = {"resolution_um_s": 0.1, "rms_um_s": 0.03, "largest_um_s": 0.05, "deviation_um_s": 0.0, "rate": 0.5}
    results: Results = {
        name: {
            "sizes": [{"neurons": size, **trip} for size in SIZES],
            "trained": {str(size): [{"rms": 3.0, "deviation": 0.0, "rate": 0.2}] for size in TRAINED_SIZES},
        }
        for name in CODES
    }
    assert shown(Codes(), results, tmp_path).misses == []
    results["population uniform"]["trained"]["50"][0]["deviation"] = 1.0
    results["Gaussian receptive fields"]["sizes"][0]["largest_um_s"] = 0.06
    misses = present(Codes(), results).misses
    assert any("less repeatable than Poisson" in miss for miss in misses)
    assert any(miss.startswith("Gaussian receptive fields, 6 neurons: largest error") for miss in misses)


@pytest.mark.parametrize("cell", list(CODES))
def test_every_code_can_feed_the_hippocampus(cell: str) -> None:
    ((found,), _) = Codes().measure(cell, SETTING)["trained"].values()
    assert np.isfinite(found["rms"])
    assert (found["deviation"] > 0) == (cell == "Poisson")


def test_learning_notes_what_took_too_long(tmp_path: Path) -> None:
    hippocampus = as_json(Learning().measure("hippocampus", SETTING))
    assert [len(phase["curve"]) for phase in hippocampus["phases"]] == [2, 2, 2]  # two steps each
    assert set(hippocampus["phases"][-1]["rms"]) == {"mean", "variance"}
    phase = {"seed": 1, "steps": 2, "seconds": 60.0, "rms": {"move": [[0.3, 0.4]]}}
    phase["curve"] = [{"seconds": 1.0, "move": 2.0}, {"seconds": 2.0, "move": 1.0}]
    same = {"same": 7, "of": 7}
    results: Results = {name: {"threads": 1, "same_as_shipped": same, "phases": [phase]} for name in PUPILS}
    assert 0 < hippocampus["same_as_shipped"]["same"] < hippocampus["same_as_shipped"]["of"]
    seconds = [point["seconds"] for phase in hippocampus["phases"] for point in phase["curve"]]
    assert seconds == sorted(seconds)
    results["hippocampus"] = dict(hippocampus)
    presentation = shown(Learning(), results, tmp_path)
    assert presentation.misses == []
    assert "move 0.354 µm" in presentation.tables[0].lines[1][-1]
    results["cerebellum"] |= {"phases": [{**phase, "seconds": 960.0}]}
    assert present(Learning(), results).misses == ["minutes of the cerebellum is 16, wanted at most 15"]
    full = page_of(Learning()).present(results, Setting(SETTING.examples))
    assert "hippocampus: not all weights are the shipped ones" in full.misses
    assert "7 of 7 in the cerebellum" in " ".join(full.words)


def test_shipped_weights_are_the_same_as_themselves() -> None:
    experiment = load_experiment(SETTING.examples / "peg_in_hole.yaml")
    found = same_as_shipped("hippocampus", weights_file("hippocampus", experiment), experiment)
    assert found["same"] == found["of"] > 0


@pytest.fixture(scope="module")
def fine_tuning() -> Results:
    return measured(Ppo())


def test_the_row_of_ppo_trains_inserts_and_draws(fine_tuning: Results, tmp_path: Path) -> None:
    shown(Ppo(), fine_tuning, tmp_path)
    found = fine_tuning[SEEDED[0].name]
    assert len(found["learning_curve"]) == len(found["seconds"]) == 1
    assert len(found["held_out"]["before"]["return"]) == 2


def test_it_tells_a_seed_that_is_worse_than_the_start(fine_tuning: Results) -> None:
    worse = copy.deepcopy(fine_tuning)
    held_out = worse[SEEDED[0].name]["held_out"]
    held_out["after"] = {name: [2.0 * value for value in values] for name, values in held_out["before"].items()}
    misses = " ".join(present(Ppo(), worse).misses)
    for part in ("upper end of the change of the cost", "mean fall of the cost", "largest force, mN is"):
        assert part in misses


def test_slower_costs_an_ideal_controller_more_distance_and_on_the_papers_rig_more_force(fine_tuning: Results) -> None:
    for rig in DEPTH_GAIN:
        fast, slow = (fine_tuning[Ideal(rig, speed).name] for speed in (100, 30))
        for part in ("distance_return", "force_return") if rig == PAPER_RIG else ("distance_return",):
            assert np.mean(slow[part]) < np.mean(fast[part])


def test_the_parts_of_a_cost_add_up_and_do_not_depend_on_its_weights(fine_tuning: Results) -> None:
    for training in QUICK_TRAININGS:
        found = fine_tuning[training.name]
        distance, force = (np.array(found["parts"][part]) for part in ("distance_return", "force_return"))
        whole = found["held_out"]["after"]["return"]
        assert distance + training.force_weight * force == pytest.approx(whole)
        assert (force <= 0).all() and len(whole) == 2


def test_a_training_that_takes_too_long_is_noted(fine_tuning: Results) -> None:
    slow = copy.deepcopy(fine_tuning)
    slow[SEEDED[0].name]["seconds"][-1] = 31 * 60.0
    assert f"{SEEDED[0].name}: minutes is 31, wanted at most 30" in present(Ppo(), slow).misses
