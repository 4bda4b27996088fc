"""The published speeds are those of the present engine, and what measures and shows them does so rightly."""

import itertools
import json
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import chart
import compare
import pytest
import report
import sweeps
import timing
import torch
from implementations import IMPLEMENTATIONS, Implementation, Native, Portable
from networks import Network, random_networks, run
from shipped import shipped_networks

from neurorobo.engine import kernels

PROJECT = Path(__file__).parents[1]
LATEST: dict[str, Any] = json.loads(compare.LATEST.read_text()) if compare.LATEST.exists() else {}

published = pytest.mark.skipif(not LATEST, reason="no speeds are published")


@published
def test_the_readme_shows_the_latest_speeds() -> None:
    readme = (PROJECT / "README.md").read_text()
    assert report.START in readme
    assert report.into_readme(readme, LATEST) == readme
    assert report.figure(LATEST["rows"]) == compare.LATEST.with_name("speed.svg").read_text()


@published
def test_the_speeds_belong_to_the_present_engine() -> None:
    """Where this fails, measure anew: `python benchmarks/engine/compare.py`."""
    assert LATEST["engine"]["source"] == compare.engine()["source"]


@published
def test_all_was_measured_with_all() -> None:
    found = {tuple(row[key] for key in (*compare.GROUP, "implementation")) for row in LATEST["rows"]}
    names = (*IMPLEMENTATIONS, report.DENSE, report.READING)
    assert found == set(itertools.product("HPC", ("random", "shipped"), report.WORKLOADS, (1, 2), names))


def row(implementation: str, median_ms: float, **more: Any) -> dict[str, Any]:
    common = {
        "network": "H",
        "inputs": "random",
        "workload": "train",
        "batch": 64,
        "threads": 1,
        "version": "1.0",
        "firing_rate": {"input": 0.3, "hidden": 0.25, "output": 0.2},
        "output_spikes": 200,
        "differing_spikes": 0,
        "memory_MB": 3.0,
    }
    return {**common, "implementation": implementation, "median_ms": median_ms, "min_ms": 1, "max_ms": 99, **more}


MACHINE = {"processor": "a processor", "cores": 2, "instructions": "avx2", "date": "2026-11-01", "torch": "2.13"}


def test_the_table_shows_the_faster_idiom_and_what_is_missing() -> None:
    rows = [
        row("neurorobo, native", 0.05678),
        row("neurorobo, native", 0.04, threads=2),
        row("snnTorch", 1234.5),
        row("snnTorch, stepwise", 20.0, memory_MB=7.0),
        row(report.DENSE, 0.5, differing_spikes=None, memory_MB=None),
    ]
    lines = report.block({"machine": MACHINE, "rows": rows}).splitlines()
    assert "| native | snnTorch | dense product |" in lines[0]
    assert lines[2] == "| H | random | 0.30, 0.25, 0.20 | training, batch 64 | 0.0568 / 0.04 | 20 / - | 0.5 / - |"
    (memory,) = (line for line in lines if line.endswith("| 3 | 7 |"))
    assert memory.startswith("| H | random | 0.30, 0.25, 0.20 | training, batch 64 |")


def test_spikes_that_differ_are_told() -> None:
    rows = [row("Norse", 1.0), row("Norse", 1.0, differing_spikes=3), row("Sinabs", 1.0)]
    text = report.block({"machine": MACHINE, "rows": rows})
    assert "up to 1.5 % of those of Norse differ" in text
    assert "All give the same spikes" in report.block({"machine": MACHINE, "rows": rows[:1]})


def test_a_readme_without_markers_stays_as_it_is() -> None:
    found = {"machine": MACHINE, "rows": [row("Norse", 1.0)]}
    assert report.into_readme("nothing", found) == "nothing"
    marked = f"before {report.START} old {report.END} after"
    shown = report.into_readme(marked, found)
    assert " old " not in shown
    assert report.into_readme(shown, found) == shown


def test_figures_are_well_formed() -> None:
    rows = [row("Norse", 1.0), row("neurorobo, native", 0.1, threads=2), row(report.DENSE, 0.5)]
    ElementTree.fromstring(report.figure(rows))
    times = [{"median_ms": ms, "min_ms": ms, "max_ms": ms} for ms in (1.0, 2.0, 4.0)]
    paths = {"native <&>": {"times": times, "slope": 1.0, "slope_of_larger_half": 1.0}}
    ElementTree.fromstring(sweeps.figure([{"size": "neurons", "numbers": [10, 20, 40], "paths": paths}]))


def test_an_axis_runs_from_power_to_power() -> None:
    axis = chart.Axis.around([0.2, 30.0], 100.0, 400.0)
    assert axis.decades() == [0.1, 1.0, 10.0, 100.0]
    assert [axis.at(number) for number in axis.decades()] == pytest.approx([100.0, 200.0, 300.0, 400.0])


def test_a_slope_is_the_exponent() -> None:
    assert sweeps.slope([1, 2, 4], [3.0, 12.0, 48.0]) == pytest.approx(2.0)


def test_a_file_is_read_as_it_was_written(tmp_path: Path) -> None:
    found = {"machine": MACHINE, "rows": [row("Norse", 1.0), row("Sinabs", 2.0)]}
    compare.write(found, tmp_path / "latest.json")
    assert json.loads((tmp_path / "latest.json").read_text()) == found
    assert len((tmp_path / "latest.json").read_text().splitlines()) < 20


def test_figures_of_another_machine_are_not_gone_on_with(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compare, "LATEST", tmp_path / "latest.json")
    found = {"engine": compare.engine(), "machine": timing.machine(), "rows": [row("Norse", 1.0)]}
    compare.write(found, compare.LATEST)
    later = {**found, "machine": {**found["machine"], "load": 1.5, "date": "2030-01-01"}, "rows": []}
    assert compare.resumed(later) == found
    with pytest.raises(SystemExit, match="another engine or machine"):
        compare.resumed({**later, "machine": {**later["machine"], "processor": "another"}})


def test_the_history_keeps_figures_by_version_and_date(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compare, "ROOT", tmp_path)
    monkeypatch.setattr(compare, "LATEST", tmp_path / "latest.json")
    (tmp_path / "benchmarks").mkdir()
    compare.write({"engine": {"version": "1.2.3"}, "machine": MACHINE, "rows": []}, compare.LATEST)
    assert compare.keep() == tmp_path / "benchmarks" / "history" / "engine-1.2.3-2026-11-01.json"
    assert compare.keep().read_text() == compare.LATEST.read_text()


SMALL = random_networks(0.1)


@pytest.mark.filterwarnings("ignore")  # of others' libraries
@pytest.mark.parametrize("network", SMALL, ids=lambda network: network.name)
@pytest.mark.parametrize("name", [name for name, it in IMPLEMENTATIONS.items() if not it.compiled])
def test_each_implementation_gives_the_spikes_of_the_equations(name: str, network: Network) -> None:
    if name not in compare.installed():
        pytest.skip(f"{name} is not installed")
    module = IMPLEMENTATIONS[name](network)
    generator = torch.Generator().manual_seed(2)
    for batch in (3, 1):
        inputs = network.draw(batch, generator)
        expected = run(network, inputs)[-1]
        with module.around(), torch.inference_mode():
            assert torch.equal(module(inputs), expected)
            assert torch.equal(module(inputs), expected)  # no window leaves anything to the next
    assert 0.05 < expected.mean() < 0.5


@pytest.mark.filterwarnings("ignore")  # of others' libraries
def test_what_rectifies_gives_the_spikes_of_the_equations() -> None:
    """With a threshold for each neuron, as the shipped H has; random potentials are often below zero."""
    (network, *_) = SMALL
    hidden, output = network.populations
    threshold = 0.4 + 0.2 * torch.rand(hidden.neurons, generator=torch.Generator().manual_seed(0))
    hidden = type(hidden)(hidden.reads, hidden.weight, None, hidden.recurrent, threshold, rectify=True)
    network = Network("H", "random", network.sizes, (hidden, output), 64)
    inputs = network.draw(4, torch.Generator().manual_seed(2))
    expected = run(network, inputs)[-1]
    plainer = type(hidden)(hidden.reads, hidden.weight, None, hidden.recurrent, threshold)
    assert not torch.equal(run(Network("H", "random", network.sizes, (plainer, output), 64), inputs)[-1], expected)
    for name in compare.installed():
        if not IMPLEMENTATIONS[name].compiled:
            module = IMPLEMENTATIONS[name](network)
            with module.around(), torch.inference_mode():
                assert torch.equal(module(inputs), expected), name


def test_the_portable_path_is_not_the_native_one() -> None:
    with Portable(SMALL[0]).around():
        assert kernels.kernels() is None


def test_the_shipped_regions_still_have_their_structure() -> None:
    networks = shipped_networks(1)
    assert [network.name for network in networks] == ["H", "P", "C"]
    for network in networks:
        inputs = network.draw(2, torch.Generator().manual_seed(0))
        with torch.inference_mode():
            assert torch.equal(Native(network)(inputs), run(network, inputs)[-1])
    with pytest.raises(ValueError, match="too few for a batch of 100000"):
        networks[0].draw(100000, torch.Generator())


@pytest.mark.parametrize("workload", ["b1", "train"])
def test_a_measurement_fills_its_rows(workload: str) -> None:
    (network, *_) = SMALL
    ours = ["neurorobo, portable"]
    (found, *floors) = compare.measure(network, workload, 1 if workload == "b1" else 4, 1, ours, rounds=2)
    assert found["differing_spikes"] == 0
    assert found["min_ms"] <= found["median_ms"] <= found["max_ms"]
    assert found["firing_rate"]["input"] == pytest.approx(0.3, abs=0.05)
    assert (found["memory_MB"] is None) == (workload == "b1" or not Path("/proc/self/clear_refs").exists())
    assert [floor["implementation"] for floor in floors] == [report.DENSE, report.READING]


def test_differences_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    class Silent(Implementation):
        library = "neurorobo"

        def forward(self, inputs: list[torch.Tensor]) -> torch.Tensor:
            return torch.zeros_like(run(SMALL[0], inputs)[-1])

    monkeypatch.setitem(IMPLEMENTATIONS, "silent", Silent)
    (found, *_) = compare.measure(SMALL[0], "b1", 1, 1, ["silent"], rounds=1)
    assert found["differing_spikes"] == found["output_spikes"] > 0


def test_memory_is_that_of_the_peak() -> None:
    def once() -> None:
        torch.ones(10_000_000).add_(1)  # given back at the end

    peak = timing.peak_MB(once)
    if peak is None:
        pytest.skip("this system does not tell the peak of memory")
    assert peak == pytest.approx(40.0, abs=4.0)
    assert timing.peak_MB(lambda: None) == pytest.approx(0.0, abs=4.0)


def test_peers_are_pinned() -> None:
    lines = (PROJECT / "benchmarks" / "engine" / "peers.txt").read_text().splitlines()
    pinned = dict(line.split("==") for line in lines if line and not line.startswith("#"))
    assert {it.library for it in IMPLEMENTATIONS.values()} - {"neurorobo", "snntorch"} <= set(pinned)
