"""A region that is exported and imported gives the same spikes, and is a region like any other."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from precision_interaction.regions.cerebellum import Cerebellum
from precision_interaction.regions.cerebellum_config import CerebellumConfig
from samples import CLOCK, NETWORKS, network, run, spikes

from neurorobo.config.experiment import load_experiment
from neurorobo.config.plugged_reader import validation_context
from neurorobo.engine import Layer
from neurorobo.errors import NeuroroboError
from neurorobo.experiment.build import build_brain
from neurorobo.experiment.closed_loop import run_episodes
from neurorobo.experiment.plan import build_plan
from neurorobo.experiment.weights import check_weights
from neurorobo.interchange.export import export_region, to_graph
from neurorobo.interchange.importing import import_network
from neurorobo.interchange.library import nir
from neurorobo.interchange.neurons import TIE
from neurorobo.neurons import spiking_neural_unit
from neurorobo.plugins import Registry
from neurorobo.regions.feedforward import Feedforward
from neurorobo.regions.feedforward_config import FeedforwardConfig
from neurorobo.regions.spiking_network import Network
from neurorobo.regions.spiking_network_config import NetworkConfig
from neurorobo.regions.weights import to_grid
from neurorobo.testing import check_region

REGISTRY = Registry.discover()
OWN = {
    "hidden": {"neurons": 30, "reads": ["inputs"], "own_thresholds": True},
    "output": {"neurons": 10, "reads": ["hidden"]},
}


@torch.no_grad()
def cerebellum() -> Cerebellum:
    """A small cerebellum with weights on a grid, as shipped ones are, so that sums are exact in any order."""
    config = CerebellumConfig(period="control", granule_cells=60, purkinje_cells=40)
    region = Cerebellum(config, CLOCK, torch.Generator().manual_seed(1)).eval()
    for parameter in region.parameters():
        parameter.copy_(to_grid(parameter))
    return region


@pytest.mark.parametrize("build", [*NETWORKS.values(), lambda seed: network(OWN, seed)], ids=[*NETWORKS, "thresholds"])
def test_a_network_comes_back_as_the_very_same(build: object, tmp_path: Path) -> None:
    region: Network = build(3)  # type: ignore[operator]
    file = tmp_path / "net.nir"
    assert export_region(region, file, REGISTRY) == []
    imported = import_network(file, REGISTRY)
    assert imported.differences == ()
    assert imported.region.config.layers.keys() == region.config.layers.keys()
    assert [layer.neuron for layer in layers(imported.region)] == [layer.neuron for layer in layers(region)]
    inputs = spikes(region, 60, 3, seed=4)
    ours, theirs = (run(each, inputs)[1] for each in (region, imported.region))
    assert all(torch.equal(ours[name], theirs[name]) for name in ours)
    assert all(0.05 < trains.mean() < 0.95 for trains in ours.values())


@pytest.mark.parametrize("own", [False, True])
def test_a_foreign_threshold_that_is_met_exactly_does_not_fire_however_often_it_is_written(
    own: bool, tmp_path: Path
) -> None:
    thresholds = np.float32([0.5, 0.25 if own else 0.5])
    zeros = np.zeros(2, np.float32)
    nodes = {
        "in": nir().Input([2]),
        "w": nir().Linear(np.diag(thresholds)),
        "lif": nir().IF(r=np.full(2, 1e4, np.float32), v_threshold=thresholds, v_reset=zeros),
        "out": nir().Output([2]),
    }
    file = tmp_path / "net.nir"
    nir().write(file, nir().NIRGraph(nodes, [("in", "w"), ("w", "lif"), ("lif", "out")]))
    texts = []
    for _ in range(3):
        imported = import_network(file, REGISTRY)
        texts.append(imported.text.replace("_lif", ""))
        with torch.no_grad():
            sent, _ = imported.region.step({"input": torch.ones(4, 1, 2)}, imported.region.init_state(1))
        assert sent["output"][:, 0, 0].tolist() == [0, 1, 0, 1]  # twice the threshold in the second step
        assert export_region(imported.region, file, REGISTRY) == []
        [node] = [node for node in nir().read(file).nodes.values() if isinstance(node, nir().IF)]
        assert np.array_equal(node.v_threshold, thresholds)
    assert "fires: above" in texts[0]
    assert texts[0] == texts[1] == texts[2]


@pytest.mark.parametrize(("fires", "expected"), [("at", 0.5 * (1 - TIE)), ("above", 0.5)])
def test_any_region_that_says_whether_ties_fire_is_written_so(fires: str, expected: float) -> None:
    port = {"unit": "1", "range": "0..1"}
    neuron = {"type": "lif", "decay": 1.0, "fires": fires}
    config = FeedforwardConfig.model_validate(
        {"inputs": {"x": port}, "outputs": {"y": port}, "hidden": [3], "neuron": neuron},
        context=validation_context(REGISTRY),
    )
    nodes = to_graph(Feedforward(config, CLOCK, torch.Generator().manual_seed(0)), REGISTRY)[0].nodes.values()
    thresholds = [node.v_threshold for node in nodes if isinstance(node, nir().IF)]
    assert len(thresholds) == 2
    assert all((each == np.float32(expected)).all() for each in thresholds)


def layers(region: Network) -> list[Layer]:
    found = [module for module in region.modules() if isinstance(module, Layer)]
    return sorted(found, key=lambda layer: layer.neurons)


def test_the_weights_in_a_file_are_ours_and_name_what_they_lead_from_and_to(tmp_path: Path) -> None:
    region = NETWORKS["recurrent, with a skip"](0)
    export_region(region, tmp_path / "net.nir", REGISTRY)
    graph = nir().read(tmp_path / "net.nir")
    assert set(graph.edges) == {
        ("input", "hidden.from_input"),
        ("hidden.from_input", "hidden.lif"),
        ("hidden.lif", "hidden.from_hidden"),
        ("hidden.from_hidden", "hidden.lif"),
        ("hidden.lif", "output.from_hidden"),
        ("input", "output.from_input"),
        ("output.from_hidden", "output.lif"),
        ("output.from_input", "output.lif"),
        ("output.lif", "output"),
    }
    hidden = region.parameter_groups()["hidden"]
    assert np.array_equal(
        graph.nodes["hidden.from_input"].weight, hidden.get_parameter("projections.0.weight").detach()
    )
    assert np.array_equal(graph.nodes["hidden.from_hidden"].weight, hidden.get_parameter("recurrent.weight").detach())


def test_a_region_of_a_plugin_comes_back_with_its_ports_and_its_spikes(tmp_path: Path) -> None:
    """Sources in another order than the ports, fixed fan-in, signs, and a port that shares its neurons with another."""
    region, file = cerebellum(), tmp_path / "cerebellum.nir"
    assert export_region(region, file, REGISTRY) == []
    imported = import_network(file, REGISTRY)
    assert imported.differences == (
        "the port `velocity` is left out: ports here have all channels, side by side, each of them once",
    )
    network = imported.region
    assert network.input_ports.keys() == region.input_ports.keys()
    assert [*network.output_ports] == ["move", "residual"]
    for theirs, ours in ((network.input_ports, region.input_ports), (network.output_ports, region.output_ports)):
        for name, port in theirs.items():
            assert (port.code, port.unit, port.width) == (ours[name].code, ours[name].unit, ours[name].width)
    inputs = spikes(region, 50, 2, seed=0)
    ports = dict(
        zip(region.input_ports, inputs.split([p.channels for p in region.input_ports.values()], -1), strict=True)
    )
    with torch.no_grad():
        before, _ = region.step(ports, region.init_state(2))
        after, _ = network.step(ports, network.init_state(2))
    assert torch.equal(before["move"], after["move"])
    assert torch.equal(before["residual"], after["residual"])
    assert 0.05 < before["move"].mean() < 0.95


def test_an_imported_network_is_validated_run_and_trained_like_any_region(tmp_path: Path) -> None:
    export_region(NETWORKS["recurrent"](2), tmp_path / "my-net.nir", REGISTRY)
    imported = import_network(tmp_path / "my-net.nir", REGISTRY)
    file = tmp_path / "folder" / "net.yaml"
    assert imported.write(file) == tmp_path / "folder" / "net.safetensors"
    with pytest.raises(NeuroroboError, match=r"net\.yaml exists already, and is left as it is; choose another place"):
        imported.write(file)
    with pytest.raises(NeuroroboError, match=r"net\.safetensors exists already"):
        imported.write(file.with_suffix(".yml"))
    with pytest.raises(NeuroroboError, match=r"is where the weights will be; call the experiment other\.yaml"):
        imported.write(tmp_path / "other.safetensors")
    experiment = load_experiment(file, ["regions.my_net.inputs.x.initial=0.7"], REGISTRY)
    plan = build_plan(experiment)
    check_weights(experiment, plan)
    brain = build_brain(experiment, plan)
    region = brain.region("my_net")
    assert isinstance(region, Network)
    assert all(torch.equal(a, b) for a, b in zip(region.parameters(), imported.region.parameters(), strict=True))
    [result] = run_episodes(brain, None, [0], duration_ns=1_000_000_000)
    assert all(0.01 < rate < 0.99 for rate in result.firing_rates.values())
    assert set(region.parameter_groups()) == {"hidden", "output"}
    inputs = spikes(region, 50, 2, seed=0)
    outputs, _ = region.step({"x": inputs}, region.init_state(2))
    outputs["y"].mean().backward()
    assert all(parameter.grad is not None and parameter.grad.any() for parameter in region.parameters())


def test_two_networks_of_the_same_name_in_one_folder_keep_their_weights(tmp_path: Path) -> None:
    for seed, file in enumerate(("x", "y")):
        export_region(NETWORKS["recurrent"](seed), tmp_path / file / "net.nir", REGISTRY)
        import_network(tmp_path / file / "net.nir", REGISTRY).write(tmp_path / "brain" / f"{file}.yaml")
    for seed, file in enumerate(("x", "y")):
        brain = build_brain(load_experiment(tmp_path / "brain" / f"{file}.yaml", (), REGISTRY))
        there, here = (region.parameters() for region in (NETWORKS["recurrent"](seed), brain.region("net")))
        assert all(torch.equal(a, b) for a, b in zip(there, here, strict=True))


def test_outputs_in_another_order_than_their_neurons_keep_their_names(tmp_path: Path) -> None:
    region = NETWORKS["recurrent"](0)
    graph, _ = to_graph(region, REGISTRY)
    notes = json.loads(graph.metadata["neurorobo"])
    port = {"unit": "mN", "width": 1, "lo": -1.0, "hi": 1.0, "code": {"type": "poisson", "neurons": 5}}
    notes["outputs"] = {"late": {**port, "channels": [*range(5, 10)]}, "early": {**port, "channels": [*range(5)]}}
    graph.metadata = {"neurorobo": json.dumps(notes)}
    nir().write(tmp_path / "net.nir", graph)
    imported = import_network(tmp_path / "net.nir", REGISTRY)
    assert [*imported.region.output_ports] == ["early", "late"]
    assert {port.unit for port in imported.region.output_ports.values()} == {"mN"}
    assert imported.differences == ()


@pytest.mark.parametrize("channels", [[*range(9, -1, -1)], [*range(0, 20, 2)], [*range(1, 11)]])
def test_ports_that_cannot_be_are_told(channels: list[int], tmp_path: Path) -> None:
    graph, _ = to_graph(NETWORKS["recurrent"](0), REGISTRY)
    notes = json.loads(graph.metadata["neurorobo"])
    notes["outputs"]["y"]["channels"] = channels
    graph.metadata = {"neurorobo": json.dumps(notes)}
    nir().write(tmp_path / "net.nir", graph)
    imported = import_network(tmp_path / "net.nir", REGISTRY)
    assert [*imported.region.output_ports] == ["output"]
    assert [*imported.region.input_ports] == ["x"]
    [told] = imported.differences
    assert "the port `y` is left out" in told
    assert f"# {told}\n" in imported.text


def test_the_quantities_of_an_imported_network_can_be_chosen(tmp_path: Path) -> None:
    """Weights know of layers alone: another unit, range or code of the same channels takes them too."""
    export_region(NETWORKS["recurrent"](2), tmp_path / "net.nir", REGISTRY)
    import_network(tmp_path / "net.nir", REGISTRY).write(tmp_path / "net.yaml")
    changes = ["unit=mN", "range=-1..1 mN", "width=2", "code.neurons=10", "code.type=poisson", "initial=0 mN"]
    experiment = load_experiment(
        tmp_path / "net.yaml", [f"regions.net.inputs.x.{change}" for change in changes], REGISTRY
    )
    check_weights(experiment, build_plan(experiment))
    other = load_experiment(tmp_path / "net.yaml", ["regions.net.inputs.x.width=2"], REGISTRY)
    with pytest.raises(NeuroroboError, match="trained for `inputs: 20`, not `inputs: 40`"):
        check_weights(other, build_plan(other))


def test_a_network_keeps_the_contract() -> None:
    config = network({"a": {"neurons": 30, "reads": ["inputs"]}, **OWN}, 0, carry="always").config
    assert isinstance(config, NetworkConfig)
    check_region(config)


def test_what_nir_has_no_node_for_is_refused_by_name() -> None:
    unit = NETWORKS["recurrent"](0)
    unit.parameter_groups()["hidden"].neuron = spiking_neural_unit()  # type: ignore[assignment]
    with pytest.raises(NeuroroboError, match="of its layer `hidden` are spiking neural units, whose potential is rect"):
        to_graph(unit, REGISTRY)


def test_without_the_library_an_error_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "nir", None)
    with pytest.raises(NeuroroboError, match=r"pip install 'neurorobo\[nir\]'"):
        nir()
