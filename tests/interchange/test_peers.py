"""Other libraries give the same spikes of every layer, up to the rounding of a potential next to the threshold."""

from pathlib import Path

import pytest
import torch
from agreement import ROUNDING, agreement
from peers import PEERS
from round_trips import EXAMPLE, MISREAD
from samples import NETWORKS, circuit, run, spikes

from neurorobo.config.experiment import load_experiment
from neurorobo.experiment.build import build_brain
from neurorobo.interchange.export import export_region, to_graph
from neurorobo.interchange.importing import import_network
from neurorobo.interchange.library import nir
from neurorobo.plugins import Registry
from neurorobo.regions.region import Region

LIBRARIES = {"snnTorch": "nirtorch", "SpikingJelly": "spikingjelly", "Norse": "norse"}
REGISTRY = Registry.discover()


def peer(name: str) -> object:
    """Return a library, or skip the test; all are in `benchmarks/engine/peers.txt`."""
    library = next(module for start, module in LIBRARIES.items() if name.startswith(start))
    pytest.importorskip(library)
    return PEERS[name]


def holds(region: Region, name: str, file: Path, seed: int, steps: int = 200, batch: int = 4) -> None:
    """Export a region, run it elsewhere, and compare the spikes of all layers."""
    export_region(region, file, REGISTRY)
    inputs = spikes(region, steps, batch, seed)
    known, ours = run(region, inputs)
    theirs = peer(name)(nir().read(file), inputs)  # type: ignore[operator]
    assert {node.removesuffix(".lif") for node in theirs} == set(ours)
    found = agreement(circuit(region), known, ours, {node.removesuffix(".lif"): theirs[node] for node in theirs})
    assert found.holds, str(found)
    assert all(0.02 < trains.mean() < 0.98 for trains in ours.values())


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize(
    ("name", "network"),
    [(name, network) for name in PEERS for network in NETWORKS if network not in MISREAD.get(name, ())],
)
def test_a_peer_gives_our_spikes(name: str, network: str, tmp_path: Path) -> None:
    for seed in range(2):
        holds(NETWORKS[network](seed), name, tmp_path / "net.nir", seed)


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize("name", ["snnTorch", "SpikingJelly", "Norse"])
@pytest.mark.parametrize("region", ["cerebellum", "prefrontal_cortex"])
def test_a_peer_gives_the_spikes_of_the_shipped_regions(name: str, region: str, tmp_path: Path) -> None:
    brain = build_brain(load_experiment(EXAMPLE, (), REGISTRY))
    holds(brain.region(region), name, tmp_path / "net.nir", seed=0, steps=50, batch=2)


def test_the_comparison_tells_rounding_from_other_neurons() -> None:
    """A spike too many counts by how far its potential is from the threshold, and by the first one of a run only."""
    region = NETWORKS["recurrent"](0)
    known, ours = run(region, spikes(region, 20, 2, seed=0))
    assert agreement(circuit(region), known, ours, ours).holds
    theirs = {name: trains.clone() for name, trains in ours.items()}
    theirs["output"][7, 1, 3] = 1 - theirs["output"][7, 1, 3]
    theirs["hidden"][9:, 1] = 0
    found = agreement(circuit(region), known, ours, theirs)
    with torch.no_grad():
        weight = region.parameter_groups()["output"].get_parameter("projections.0.weight").double()
        potential, before = 0.0, 0.0
        for now in range(8):
            potential = 0.2 * potential * (1 - before) + float(weight[3] @ ours["hidden"][now, 1].double())
            before = float(ours["output"][now, 1, 3])
    assert found.first_distances == (pytest.approx(abs(potential - 0.5)),)
    assert found.first_distances[0] > ROUNDING
    assert not found.holds


@pytest.mark.filterwarnings("ignore")
def test_what_spikingjelly_exports_is_imported_with_its_spikes(tmp_path: Path) -> None:
    """Its reset may be to another potential than zero, if it is the resting one; it fires at the threshold too."""
    pytest.importorskip("spikingjelly")
    from spikingjelly.activation_based import functional, neuron
    from spikingjelly.activation_based.nir_exchange import export_to_nir

    with torch.random.fork_rng():
        torch.manual_seed(0)
        model = torch.nn.Sequential(
            torch.nn.Linear(20, 30),
            neuron.LIFNode(tau=2.5, v_reset=-0.2, v_threshold=0.8, decay_input=False),
            torch.nn.Linear(30, 5, bias=False),
            neuron.IFNode(v_threshold=0.3),
        )
    with torch.no_grad():
        for parameter in model.parameters():
            parameter.mul_(3)
    export_to_nir(model, torch.zeros(1, 20), tmp_path / "theirs.nir")
    functional.reset_net(model)
    imported = import_network(tmp_path / "theirs.nir", REGISTRY)
    inputs = spikes(imported.region, 100, 3, seed=5)
    with torch.no_grad():
        theirs = torch.stack([model(now) for now in inputs])
    ours = run(imported.region, inputs)[1]
    assert torch.equal(ours["layer_3"], theirs)
    assert 0.02 < theirs.mean() < 0.98


@pytest.mark.filterwarnings("ignore")
def test_what_snntorch_exports_is_imported_with_its_spikes(tmp_path: Path) -> None:
    """A recurrent layer of its own is a graph within the graph."""
    pytest.importorskip("nirtorch")
    import snntorch
    from snntorch.export_nir import export_to_nir

    settings = {"init_hidden": True, "reset_mechanism": "zero", "reset_delay": False}

    class Model(torch.nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.weights_1 = torch.nn.Linear(20, 30)
            self.neurons_1 = snntorch.Leaky(beta=torch.full((30,), 0.8), threshold=torch.full((30,), 0.7), **settings)
            self.weights_2 = torch.nn.Linear(30, 5)
            self.neurons_2 = snntorch.Leaky(beta=torch.full((5,), 0.9), threshold=torch.ones(5), **settings)

        def forward(self, spikes: torch.Tensor) -> torch.Tensor:
            out: torch.Tensor = self.neurons_2(self.weights_2(self.neurons_1(self.weights_1(spikes))))
            return out

    with torch.random.fork_rng():
        torch.manual_seed(0)
        model = Model()
    with torch.no_grad():
        for parameter in (model.weights_1.weight, model.weights_2.weight):
            parameter.mul_(3)
    graph = export_to_nir(model, torch.zeros(1, 20), ignore_dims=[0])
    nir().write(tmp_path / "theirs.nir", graph)
    model.neurons_1.reset_mem()
    model.neurons_2.reset_mem()
    imported = import_network(tmp_path / "theirs.nir", REGISTRY)
    inputs = spikes(imported.region, 100, 3, seed=5)
    with torch.no_grad():
        theirs = torch.stack([model(now) for now in inputs])
    ours = run(imported.region, inputs)[1]
    assert torch.equal(ours["neurons_2"], theirs)
    assert 0.02 < theirs.mean() < 0.98


def test_a_graph_within_the_graph_is_taken_apart(tmp_path: Path) -> None:
    """As snnTorch writes a recurrent layer."""
    region = NETWORKS["recurrent"](1)
    graph, _ = to_graph(region, REGISTRY)
    inner = ("hidden.lif", "hidden.from_hidden")
    nodes = {
        "input": nir().Input([30]),
        "lif": graph.nodes[inner[0]],
        "w_rec": graph.nodes[inner[1]],
        "output": nir().Output([30]),
    }
    edges = [("input", "lif"), ("lif", "w_rec"), ("w_rec", "lif"), ("lif", "output")]
    outer = {name: node for name, node in graph.nodes.items() if name not in inner}
    outer["hidden"] = nir().NIRGraph(nodes, edges)
    path = [("input", "hidden.from_input"), ("hidden.from_input", "hidden"), ("hidden", "output.from_hidden")]
    path += [("output.from_hidden", "output.lif"), ("output.lif", "output")]
    nir().write(tmp_path / "net.nir", nir().NIRGraph(outer, path, metadata=graph.metadata))
    imported = import_network(tmp_path / "net.nir", REGISTRY).region
    inputs = spikes(region, 50, 2, seed=0)
    ours, theirs = run(region, inputs)[1], run(imported, inputs)[1]
    assert all(torch.equal(ours[name], theirs[name]) for name in ours)
