"""The published speeds are those of the present engine, and what measures and shows them does so rightly."""

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
from machine import machine
from networks import Network, random_networks, run
from shipped import shipped_networks

from neurorobo.engine import kernels
from tests.engine.paths import INSTALLED

PROJECT = Path(__file__).parents[1]
README = (PROJECT / "README.md").read_text()
LATEST: dict[str, Any] = json.loads(compare.LATEST.read_text()) if compare.LATEST.exists() else {}

published = pytest.mark.skipif(not LATEST, reason="no speeds are published: python benchmarks/engine/compare.py")


def test_the_readme_has_a_place_for_speeds() -> None:
    assert README.count(report.START) == README.count(report.END) == 1


@published
def test_the_readme_shows_the_latest_speeds() -> None:
    assert report.into_readme(README, LATEST) == README
    assert report.figure(LATEST["rows"]) == compare.LATEST.with_name("speed.svg").read_text()


@published
def test_the_history_has_the_latest_speeds() -> None:
    assert json.loads((compare.HISTORY / f"engine-{LATEST['engine']['version']}.json").read_text()) == LATEST


@published
def test_the_speeds_belong_to_the_present_engine() -> None:
    """Speeds say of which engine they are, so older ones are not wrong; but a release is to be measured anew."""
    assert LATEST["engine"]["version"] == compare.engine()["version"], "measure: python benchmarks/engine/compare.py"
    if LATEST["engine"] != compare.engine():
        pytest.skip("the published speeds are of another engine; before a release: python benchmarks/engine/compare.py")


@published
def test_all_was_measured_with_all() -> None:
    assert compare.is_complete(LATEST["rows"])
    assert not compare.is_complete(LATEST["rows"][1:])
    assert not compare.is_complete([{**LATEST["rows"][0], "samples": 1}, *LATEST["rows"][1:]])


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
        "samples": 5,
    }
    return {**common, "implementation": implementation, "median_ms": median_ms, "min_ms": 1, "max_ms": 99, **more}


MACHINE = {"processor": "a processor", "cores": 2, "instructions": "avx2", "date": "2026-11-01", "torch": "2.13"}
ENGINE = {"version": "1.2.3", "source": "abc"}


def block(rows: list[dict[str, Any]]) -> str:
    return report.block({"engine": ENGINE, "machine": MACHINE, "rows": rows})


def test_the_table_shows_ratios_and_what_is_missing() -> None:
    rows = [
        row("neurorobo, native", 0.05678),
        row("neurorobo, native", 0.04, threads=2),
        row("neurorobo, native, bf16", 0.05),
        row("snnTorch", 1234.5),
        row("snnTorch, stepwise", 20.0, memory_MB=7.0),
        row("snnTorch, compiled", 10.0, memory_MB=None),
        row(report.DENSE, 0.5, differing_spikes=None, memory_MB=None),
    ]
    text = block(rows)
    (line,) = (line for line in text.splitlines() if line.startswith("| H"))
    assert line == (
        "| H | random | 0.30, 0.25, 0.20 | training, batch 64 | 0.0568, bf16 0.05 | - | 20 / 1234 "
        "| 10 (snnTorch, compiled) | 352 (3.3) / 21742 / 176 | - (1.7) / - / - |"
    )
    assert "snnTorch's loop: H random 3 / 7." in text
    assert "neurorobo 1.2.3 (engine abc)" in text


def test_what_is_missed_is_told() -> None:
    ours, peers = row("neurorobo, native", 10.0), [row("snnTorch, stepwise", 33.0), row("Norse", 15.0)]
    assert report.misses([{**ours, "memory_MB": 2.0}, *peers]) == []
    slower = {**ours, "median_ms": 11.0, "differing_spikes": 1}
    assert [miss.removeprefix("H random, train, 1 thread: ") for miss in report.misses([slower, *peers])] == [
        "neurorobo, native is 3 times as fast as snnTorch, stepwise, wanted 3.3",
        "neurorobo, native is 1.364 times as fast as Norse, wanted 1.5",
        "neurorobo, native takes 3 MB, wanted less than snnTorch's 3",
        "1 of the output spikes of neurorobo, native differ from those of the equations",
    ]
    two = [{**one, "threads": 2} for one in ({**ours, "median_ms": 11.0, "memory_MB": 2.0}, *peers)]
    assert [miss.split(": ")[1] for miss in report.misses(two)] == [
        "neurorobo, native is 1.364 times as fast as Norse, wanted 1.5"
    ]


def test_spikes_that_differ_are_told() -> None:
    rows = [row("Norse", 1.0), row("Norse", 1.0, workload="b1", differing_spikes=3), row("Sinabs", 1.0)]
    assert "up to 1.5 % of those of Norse differ" in block(rows)
    assert "All give the same spikes" in block(rows[:1])


def test_only_what_stands_between_the_markers_is_replaced() -> None:
    found = {"engine": ENGINE, "machine": MACHINE, "rows": [row("Norse", 1.0)]}
    marked = f"before {report.START} old {report.END} after"
    shown = report.into_readme(marked, found)
    assert shown.startswith("before ")
    assert shown.endswith(" after")
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
    monkeypatch.setattr(compare, "UNFINISHED", tmp_path / "unfinished.json")
    found = {"engine": compare.engine(), "machine": machine(), "rows": [row("Norse", 1.0)]}
    with pytest.raises(SystemExit, match="nothing to resume"):
        compare.resumed(found)
    compare.write(found, compare.UNFINISHED)
    later = {**found, "machine": {**found["machine"], "load": 1.5, "date": "2030-01-01"}, "rows": []}
    assert compare.resumed(later) == found
    with pytest.raises(SystemExit, match="another engine or machine"):
        compare.resumed({**later, "machine": {**later["machine"], "processor": "another"}})


def test_publishing_writes_all_that_must_agree(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compare, "ROOT", tmp_path)
    monkeypatch.setattr(compare, "LATEST", tmp_path / "latest.json")
    monkeypatch.setattr(compare, "HISTORY", tmp_path / "history")
    (tmp_path / "README.md").write_text(f"{report.START}{report.END}")
    found = {"engine": ENGINE, "machine": MACHINE, "rows": [row("Norse", 1.0)]}
    compare.publish(found)
    assert json.loads((tmp_path / "history" / "engine-1.2.3.json").read_text()) == found
    assert json.loads(compare.LATEST.read_text()) == found
    assert "Norse 1.0" in (tmp_path / "README.md").read_text()
    assert (tmp_path / "speed.svg").exists()


def test_a_run_goes_on_where_it_was_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The second group is interrupted, and the rest follows with ``--resume``; with one round, nothing is published."""
    monkeypatch.setattr(compare, "UNFINISHED", tmp_path / "unfinished.json")
    monkeypatch.setattr(compare, "publish", lambda found: pytest.fail("published"))
    monkeypatch.setattr(compare, "random_networks", lambda: SMALL[:1])
    monkeypatch.setattr(compare, "shipped_networks", lambda episodes: [])
    measured = []

    def measure(network: Network, workload: str, *_: object) -> list[dict[str, Any]]:
        measured.append(workload)
        if len(measured) == 2:
            raise KeyboardInterrupt
        return [row("Norse", 1.0, workload=workload)]

    monkeypatch.setattr(compare, "measure", measure)
    arguments = ["compare.py", "--rounds", "1", "--threads", "1"]
    monkeypatch.setattr("sys.argv", arguments)
    assert compare.main() == 130
    monkeypatch.setattr("sys.argv", [*arguments, "--resume"])
    assert compare.main() == 0
    assert measured == ["b1", "b256", "b256", "train"]
    assert [found["workload"] for found in json.loads(compare.UNFINISHED.read_text())["rows"]] == [*report.WORKLOADS]
    assert "nothing is published" in capsys.readouterr().out


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
@pytest.mark.parametrize("network", SMALL, ids=lambda network: network.name)
def test_the_same_is_learnt(network: Network) -> None:
    """snnTorch and SpikingJelly have the same gradients; Norse and Sinabs have other surrogates."""
    gradients = {}
    inputs = network.draw(4, torch.Generator().manual_seed(2))
    for name in ("neurorobo, portable", *({"snnTorch", "snnTorch, stepwise", "SpikingJelly"} & {*compare.installed()})):
        module = IMPLEMENTATIONS[name](network)
        with module.around():
            (module(inputs).mean(0) - 0.1).square().mean().backward()
        last_but_one = module.layers[-2].projections[0] if isinstance(module, Native) else module.linear[-2]  # type: ignore[union-attr, index]
        gradients[name] = last_but_one.weight.grad
    ours = gradients["neurorobo, portable"]
    assert ours.abs().max() > 0
    for name, gradient in gradients.items():
        torch.testing.assert_close(gradient, ours, rtol=1e-3, atol=1e-4 * float(ours.abs().max()), msg=name)


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


@INSTALLED
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


def test_the_readme_shows_the_latest_slopes() -> None:
    assert README.count(sweeps.START) == README.count(sweeps.END) == 1
    if not sweeps.LATEST.exists():
        pytest.skip("no slopes are published: python benchmarks/engine/sweeps.py")
    found = json.loads(sweeps.LATEST.read_text())
    assert sweeps.into_readme(README, found) == README
    assert sweeps.figure(found["sweeps"]) == sweeps.LATEST.with_suffix(".svg").read_text()
    for one in found["sweeps"]:
        for path in one["paths"].values():
            medians = [time["median_ms"] for time in path["times"]]
            assert path["slope"] == sweeps.slope(one["numbers"], medians)
