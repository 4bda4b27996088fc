"""A file that is no network of ours is refused with one clear error: the file, the node and its kind, what to do."""

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from samples import NETWORKS

from neurorobo.config.document import parse_document
from neurorobo.errors import NeuroroboError
from neurorobo.interchange.export import to_graph
from neurorobo.interchange.importing import Imported, import_network
from neurorobo.interchange.library import nir
from neurorobo.plugins import Registry

REGISTRY = Registry()


def refused(path: Path) -> str:
    """Return why a file is refused."""
    with pytest.raises(NeuroroboError) as error:
        import_network(path, REGISTRY)
    return str(error.value)


def graph(**changes: Any) -> Any:
    """Return a graph of two populations with some nodes changed, or left out if they are None."""
    whole, _ = to_graph(NETWORKS["recurrent"](0), REGISTRY)
    nodes = {**whole.nodes, **{name.replace("__", "."): node for name, node in changes.items()}}
    kept = {name: node for name, node in nodes.items() if node is not None}
    edges = [edge for edge in whole.edges if edge[0] in kept and edge[1] in kept]
    return nir().NIRGraph(kept, edges, type_check=False, metadata=whole.metadata)


def ones(*shape: int) -> np.ndarray[Any, Any]:
    return np.ones(shape, np.float32)


def lif(count: int = 10, **changes: Any) -> Any:
    values = {"tau": ones(count) * 2e-4, "r": ones(count), "v_leak": ones(count) * 0, "v_threshold": ones(count)}
    return nir().LIF(**{**values, "v_reset": ones(count) * 0, **changes})


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "there is no file"),
        (b"", "is no whole file of NIR"),
        (b"neurorobo: 1\n", "is no whole file of NIR"),
        (b"\x89HDF\r\n\x1a\n" + bytes(200), "is no whole file of NIR"),
    ],
)
def test_what_is_no_file_of_nir_is_refused(content: bytes | None, words: str, tmp_path: Path) -> None:
    path = tmp_path / "net.nir"
    if content is not None:
        path.write_bytes(content)
    assert words in refused(path)
    assert str(path) in refused(path)
    assert "is no whole file of NIR" in refused(tmp_path)


def test_a_truncated_file_and_another_file_of_hdf5_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "net.nir"
    nir().write(path, graph())
    import_network(path, REGISTRY)
    path.write_bytes(path.read_bytes()[:-500])
    assert "is no whole file of NIR" in refused(path)
    with h5py.File(path, "w") as file:
        file["data"] = np.zeros(3)
    assert "is no whole file of NIR" in refused(path)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda n: {"output__lif": n.CubaLIF(*(ones(10) for _ in range(5)))}, "`output.lif` (CubaLIF)"),
        (lambda n: {"output__lif": n.LI(ones(10), ones(10), ones(10))}, "it does not spike, and layers here do"),
        (lambda n: {"output__lif": n.Threshold(ones(10))}, "(Threshold)"),
        (lambda n: {"hidden__from_input": n.Scale(ones(30))}, "multiply it into those of the next Linear"),
        (lambda n: {"hidden__from_input": n.Delay(ones(30))}, "delay the input instead"),
        (lambda n: {"hidden__from_hidden": n.Flatten({"input": np.array([30])}, 0, 0)}, "leave it out"),
        (
            lambda n: {"hidden__from_input": n.Linear(ones(30, 21))},
            "of (30, 21), and from `input` to `hidden.lif` (30,",
        ),
        (lambda n: {"output__from_hidden": n.Linear(ones(9, 30))}, "(10, 30) are needed"),
        (lambda n: {"hidden__from_hidden": n.Linear(ones(30, 29))}, "(30, 30) are needed"),
        (lambda n: {"hidden__from_input": n.Linear(ones(30, 20) * np.nan)}, "`hidden.from_input` (Linear) cannot be"),
        (lambda n: {"hidden__from_input": n.Affine(ones(30, 20), ones(7))}, "`bias` is of (7,), (30,) is needed"),
        (lambda n: {"output__lif": lif(11)}, "of (10, 30), and from `hidden.lif` to `output.lif` (11, 30) are needed"),
        (lambda n: {"output__lif": lif(tau=ones(10) * 1e-5)}, "say which step it was made for with `--dt`"),
        (lambda n: {"output": n.Output([11])}, "it has 11 channels, and `output.lif` 10 neurons"),
        (lambda n: {"input": n.Input([4, 5])}, "the node `input` (Input) is of the shape (4, 5)"),
        (lambda n: {"input": None}, "a network has one Input here, and the file has 0"),
        (lambda n: {"second": n.Output([3])}, "a network has one Output here, and the file has 2"),
        (lambda n: {"output__from_hidden": None}, "nothing leads to it"),
        (lambda n: {"hidden__from_input": None}, "nothing but itself leads to it"),
        (lambda n: {"spare": n.Linear(ones(3, 3))}, "the node `spare` (Linear) cannot be imported: it leads nowhere"),
    ],
)
def test_a_node_that_layers_cannot_be_made_of_is_refused_by_name(
    make: Callable[[Any], dict[str, Any]], words: str, tmp_path: Path
) -> None:
    nir().write(tmp_path / "net.nir", graph(**make(nir())))
    assert words in refused(tmp_path / "net.nir")


@pytest.mark.parametrize(
    ("edges", "words"),
    [
        ([("input", "output.lif")], "`input` leads to it without weights; put a Linear node between them"),
        ([("hidden.from_input", "output")], "it is not of the spikes of one node"),
        ([("hidden.lif", "hidden.from_input")], "it reads `hidden.lif` and `input`"),
        ([("output.lif", "back"), ("back", "hidden.lif")], "excite one another in a circle"),
        ([("output.lif", "nobody")], "there is no `nobody`"),
    ],
)
def test_edges_that_are_no_layers_are_refused(edges: list[tuple[str, str]], words: str, tmp_path: Path) -> None:
    changed = graph(back=nir().Linear(ones(30, 10))) if edges[0][1] == "back" else graph()
    changed.edges += edges
    nir().write(tmp_path / "net.nir", changed)
    assert words in refused(tmp_path / "net.nir")


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ("nodes/hidden.lif/tau", "the node `hidden.lif` (LIF) of {path} has no `tau`; export it again"),
        ("nodes/hidden.from_input/weight", "the node `hidden.from_input` (Linear) of {path} has no `weight`"),
        ("nodes/hidden.from_input/type", "is no whole file of NIR"),
        ("edges", "the node (NIRGraph) of {path} has no `edges`"),
    ],
)
def test_what_is_missing_in_a_file_is_named(place: str, words: str, tmp_path: Path) -> None:
    path = tmp_path / "net.nir"
    nir().write(path, graph())
    with h5py.File(path, "r+") as file:
        del file[f"node/{place}"]
    assert words.format(path=path) in refused(path)


def test_a_node_of_a_kind_that_nobody_knows_is_named(tmp_path: Path) -> None:
    path = tmp_path / "net.nir"
    nir().write(path, graph())
    with h5py.File(path, "r+") as file:
        del file["node/nodes/output.lif/type"]
        file["node/nodes/output.lif/type"] = "Izhikevich"
    assert f"the node `output.lif` (Izhikevich) of {path} cannot be imported: there is no such node in NIR" in refused(
        path
    )


def noted(notes: str, tmp_path: Path) -> Imported:
    """Import a file with other notes, which must be passed over with one line that tells why."""
    changed = graph()
    changed.metadata = {"neurorobo": notes}
    nir().write(tmp_path / "net.nir", changed)
    imported = import_network(tmp_path / "net.nir", REGISTRY)
    assert "fires: above" in imported.text
    assert "fires: at" not in imported.text
    [difference] = imported.differences
    assert difference.startswith("the notes of neurorobo are passed over: ")
    assert difference.isprintable()
    parse_document(imported.text, "")
    return imported


@pytest.mark.parametrize("notes", ["", "[]", "{", '{"layers": 3}', '{"layers": {"hidden.lif": {"decay": "x"}}}'])
def test_notes_that_are_not_ours_are_passed_over(notes: str, tmp_path: Path) -> None:
    noted(notes, tmp_path)


@pytest.mark.parametrize(
    ("place", "value", "words"),
    [
        ("carried", 5, "carried: Input should be a valid"),
        ("carry", "often", "carry: Input should be 'never', 'repeat' or 'always'"),
        ("step_s", math.inf, "step_s: "),
        ("step_s", -1.0, "step_s: "),
        ("step_s", "0.1", "step_s: "),
        ("spike_step", "soon", "spike_step: 'soon' is no"),
        ("spike_step", 3, "spike_step: "),
        ("window", 0, "window: must be at least 1 spike step"),
        ("window", True, "window: "),
        ("inputs/x/lo", 2.0, "inputs.x: range: "),
        ("inputs/x/hi", math.nan, "inputs.x.hi: "),
        ("inputs/x/width", 0, "inputs.x: "),
        ("inputs/x/width", 3, "inputs.x: "),
        ("inputs/x/unit", "mN/0", "inputs.x: unit: "),
        ("inputs/x/unit", "a\nb", "inputs.x: unit: "),
        ("inputs/x/channels", [], "inputs.x.channels: "),
        ("inputs/x/channels", ["a"], "inputs.x.channels.0: "),
        ("outputs/y/code", {"type": "nothing"}, "outputs.y: code.type: "),
        ("outputs/y/code", {"type": "poisson", "neurons": -1}, "outputs.y: code"),
        ("outputs/y/code", 3, "outputs.y.code: "),
        ("outputs/x y", {}, "outputs.x y"),
        ("outputs/a\nb: c", {}, "outputs.a"),
        ("layers/hidden.lif", {"decay": 2.0, "thresholds": []}, "layers.hidden.lif.decay: "),
        ("layers/output.lif", {"decay": 0.5, "thresholds": [1e300] * 10}, "layers.output.lif.thresholds.0: "),
    ],
)
def test_one_bad_note_is_named_and_all_are_passed_over(place: str, value: object, words: str, tmp_path: Path) -> None:
    notes = json.loads(graph().metadata["neurorobo"])
    *path, last = place.split("/")
    inner = notes
    for key in path:
        inner = inner[key]
    inner[last] = value
    assert words in noted(json.dumps(notes), tmp_path).differences[0]


def test_a_layer_called_as_a_port_gets_another_name(tmp_path: Path) -> None:
    """The name of the port is ours, or is noted; neither is the fault of the file."""
    whole = graph()
    for name in ("input", "x"):
        nodes = {
            name.join(each.split("hidden")) if each == "hidden.lif" else each: n for each, n in whole.nodes.items()
        }
        edges = [tuple(f"{name}.lif" if end == "hidden.lif" else end for end in edge) for edge in whole.edges]
        nir().write(tmp_path / "net.nir", nir().NIRGraph(nodes, edges, metadata=whole.metadata))
        imported = import_network(tmp_path / "net.nir", REGISTRY)
        assert [*imported.region.config.layers] == [f"{name}_", "output"]


def test_notes_about_another_node_do_not_change_it(tmp_path: Path) -> None:
    """A file that some other tool has changed is what its nodes say."""
    whole, _ = to_graph(NETWORKS["recurrent"](0), REGISTRY)
    whole.nodes["output.lif"] = lif(v_threshold=ones(10) * 0.35)
    nir().write(tmp_path / "net.nir", whole)
    config = import_network(tmp_path / "net.nir", REGISTRY).region.config
    assert config.layers["hidden"].neuron.build(10**6).threshold == 0.5
    assert config.layers["output"].neuron.build(10**6).decay == 0.5
    assert config.layers["output"].neuron.build(10**6).threshold == pytest.approx(0.7)
