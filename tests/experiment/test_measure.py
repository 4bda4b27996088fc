"""What `neurorobo measure` counts in the closed loop."""

from pathlib import Path
from typing import Any

import pytest

from neurorobo.config.experiment import Experiment, load_experiment
from neurorobo.experiment.build import build_brain, build_task
from neurorobo.experiment.closed_loop import run_episodes
from neurorobo.experiment.measure import measure_experiment
from neurorobo.experiment.weights import weights_file
from neurorobo.plugins import Registry
from tests.experiment.toys import CART, registry

EXAMPLE = Path(__file__).parents[2] / "examples" / "peg_in_hole.yaml"
SHORT = ("body.length=150 um", "regions.gap.length=150 um")


def cart(folder: Path) -> Experiment:
    (folder / "cart.yaml").write_text(CART)
    return load_experiment(folder / "cart.yaml", (), registry())


def test_the_counts_are_those_of_the_episodes_as_they_run(tmp_path: Path) -> None:
    """Episodes end at their own time; a step at every other period runs in the first of two."""
    experiment = cart(tmp_path)
    task = build_task(experiment)
    episodes = [run_episodes(build_brain(experiment), task, [seed])[0] for seed in (3, 4, 5)]
    found = measure_experiment(experiment, [3, 4, 5])
    durations = [episode.metrics["duration_s"] for episode in episodes]
    assert found["control_periods"] == sum(durations)
    windows = [(duration + 1) // 2 for duration in durations]
    watcher = found["regions"]["watcher"]
    assert watcher["windows"] == pytest.approx(sum(windows) / sum(durations))
    rates = [episode.firing_rates["watcher"] for episode in episodes]
    fired = sum(rate * n for rate, n in zip(rates, windows, strict=True)) / sum(windows)
    assert watcher["activation_sparsity"] == pytest.approx(1 - fired)
    synapses = 12 * 10 + 10 * 10 + 10 * 6 + 12 * 6
    assert watcher["dense"] == pytest.approx(synapses * 20 * watcher["windows"])
    assert 0 < watcher["effective_acs"] < watcher["dense"]
    assert watcher["connection_sparsity"] == pytest.approx(90 / synapses)  # a fan-in of 3 of 12


def test_a_region_that_only_computes_says_so(tmp_path: Path) -> None:
    driver = measure_experiment(cart(tmp_path), [3])["regions"]["driver"]
    assert driver["not_counted"] == ["what it computes, as it has no spiking layers"]
    assert (driver["parameter_count"], driver["connection_sparsity"], driver["stored"]) == (0, None, None)
    assert (driver["activation_sparsity"], driver["effective_acs"], driver["windows"]) == (None, 0, 1)


@pytest.fixture(scope="module")
def insertion() -> tuple[Experiment, dict[str, Any]]:
    experiment = load_experiment(EXAMPLE, SHORT, Registry.discover())
    return experiment, measure_experiment(experiment, [1000])


def test_the_shipped_brain_by_region_and_use(insertion: tuple[Experiment, dict[str, Any]]) -> None:
    experiment, found = insertion
    (episode,) = run_episodes(build_brain(experiment), build_task(experiment), [1000])
    regions = found["regions"]
    for name, rate in episode.firing_rates.items():
        assert regions[name]["activation_sparsity"] == pytest.approx(1 - rate)
    assert set(regions) == {"hippocampus", "cerebellum", "prefrontal_cortex", "gap", "add"}
    assert {name: regions[name]["windows"] for name in episode.firing_rates} == {
        "hippocampus": 4,  # three to imagine, one to act
        "cerebellum": 4,
        "prefrontal_cortex": 1,
    }
    assert regions["cerebellum"]["dense"] == 4 * 50 * (64 * 4000 + 4000 * 1600 + (1600 + 64) * 8 + 8 * 40)
    assert regions["cerebellum"]["stored"] == weights_file("cerebellum", experiment).stat().st_size
    assert regions["prefrontal_cortex"]["not_counted"] == ["prediction.weight", "terminal.weight"]


def test_uses_add_up_to_regions_and_regions_to_the_total(insertion: tuple[Experiment, dict[str, Any]]) -> None:
    _, found = insertion
    for count in ("windows", "effective_macs", "effective_acs", "dense"):
        for region in found["regions"].values():
            assert region[count] == pytest.approx(sum(use[count] for use in region["uses"].values()))
        assert found["total"][count] == pytest.approx(sum(region[count] for region in found["regions"].values()))
    for size in ("parameter_count", "footprint"):
        assert found["total"][size] == sum(region[size] for region in found["regions"].values())
