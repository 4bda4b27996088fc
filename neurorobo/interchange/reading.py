"""Reading a file of NIR: everything that can be wrong with it is told by the name of the node."""

import math
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from neurorobo.errors import NeuroroboError
from neurorobo.interchange.export import NOTES
from neurorobo.interchange.library import nir
from neurorobo.interchange.notes import Notes, read_notes
from neurorobo.plugins import Registry

NEURONS = ("LIF", "IF")
SYNAPSES = ("Linear", "Affine")

_PARAMETERS = {
    "Input": ("shape",),
    "Output": ("shape",),
    "NIRGraph": ("nodes", "edges"),
    "Linear": ("weight",),
    "Affine": ("weight", "bias"),
    "LIF": ("tau", "r", "v_leak", "v_threshold"),
    "IF": ("r", "v_threshold"),
}
_INSTEAD = {
    "CubaLIF": "its current leaks, and the neurons here sum their inputs anew in every step; train it with LIF nodes",
    "CubaLI": "it does not spike, and layers here do; end with a LIF node and decode its spikes",
    "LI": "it does not spike, and layers here do; end with a LIF node and decode its spikes",
    "I": "it does not spike, and layers here do; take an IF node",
    "Threshold": "it has no state, and neurons here have; take a LIF node whose tau is one step",
    "Scale": "there is nothing but weights here; multiply it into those of the next Linear",
    "Conv1d": "there are no convolutions here; write it out as a Linear node",
    "Conv2d": "there are no convolutions here; write it out as a Linear node",
    "SumPool2d": "there is no pooling here; write it out as a Linear node",
    "AvgPool2d": "there is no pooling here; write it out as a Linear node",
    "Flatten": "populations are rows here already; leave it out",
    "Delay": "all connections here are of one step; delay the input instead",
}


@dataclass(frozen=True)
class Graph:
    """The nodes of a file by name, those of graphs within graphs too, the edges between them, and our own notes.

    ``unread`` tells why notes that are there cannot be believed.
    """

    nodes: dict[str, Any]
    edges: frozenset[tuple[str, str]]
    notes: Notes | None
    unread: str | None

    def into(self, name: str) -> list[str]:
        """Return the nodes that lead to a node, in the order of the file."""
        return [node for node in self.nodes if (node, name) in self.edges]

    def out_of(self, name: str) -> list[str]:
        """Return the nodes that a node leads to, in the order of the file."""
        return [node for node in self.nodes if (name, node) in self.edges]

    def of(self, *kinds: str) -> list[str]:
        """Return the nodes of some kinds, in the order of the file."""
        return [name for name, node in self.nodes.items() if kind(node) in kinds]


def kind(node: Any) -> str:
    """Return what kind of node it is, in the words of NIR."""
    return type(node).__name__


def read_graph(path: Path, registry: Registry) -> Graph:
    """Read a file of NIR; HDF5 holds numbers and text, so that nothing is run.

    Raises a NeuroroboError if there is no such file, it is no whole file of NIR, a node is of a kind that layers cannot
    be made of, lacks a parameter or leads to nowhere.
    """
    package = nir()
    import h5py

    try:
        path.open("rb").close()
        with h5py.File(path) as file:
            _check_kinds(path, "", file["node"])
        graph = package.read(path, type_check=False)
    except NeuroroboError:
        raise
    except FileNotFoundError:
        raise NeuroroboError(f"there is no file {path}; name a file of NIR") from None
    except Exception as error:  # of h5py and nir, of whatever type
        raise NeuroroboError(f"{path} is no whole file of NIR ({error}); export it again") from None
    if kind(graph) != "NIRGraph":
        raise NeuroroboError(f"{path} holds a node and no graph; export the graph that it is part of")
    found = read_notes(graph.metadata[NOTES], registry) if NOTES in graph.metadata else None
    return Graph(*_flattened(graph), *((None, found) if isinstance(found, str) else (found, None)))


def _check_kinds(path: Path, name: str, group: Any) -> None:
    """Raise a NeuroroboError for the first node that is not understood, or lacks what a node of its kind has."""
    value = group["type"][()]
    found = value.decode() if isinstance(value, bytes) else str(value)
    named = f"the node `{name}` ({found}) of {path}" if name else f"the node ({found}) of {path}"
    if found not in _PARAMETERS:
        cure = _INSTEAD.get(found, "there is no such node in NIR as it is known here; export the network without it")
        raise NeuroroboError(f"{named} cannot be imported: {cure}")
    if missing := [parameter for parameter in _PARAMETERS[found] if parameter not in group]:
        raise NeuroroboError(f"{named} has no `{missing[0]}`; export it again")
    if found == "NIRGraph":
        for inner, node in group["nodes"].items():
            _check_kinds(path, f"{name}.{inner}" if name else inner, node)


def _flattened(graph: Any, prefix: str = "") -> tuple[dict[str, Any], frozenset[tuple[str, str]]]:
    """Return all nodes, and all edges, with the graphs within the graph replaced by what is in them."""
    nodes: dict[str, Any] = {}
    edges = {(prefix + source, prefix + target) for source, target in graph.edges}
    for name, node in graph.nodes.items():
        if kind(node) != "NIRGraph":
            nodes[prefix + name] = node
            continue
        inner_nodes, inner_edges = _flattened(node, f"{prefix}{name}.")
        doors = {inner: kind(each) for inner, each in inner_nodes.items() if kind(each) in ("Input", "Output")}
        counted = Counter(doors.values())
        if counted != {"Input": 1, "Output": 1}:
            raise NeuroroboError(f"the graph `{prefix}{name}` within the graph needs one Input and one Output")
        way_in, way_out = sorted(doors, key=lambda door: doors[door])
        edges = {
            (way_out if source == prefix + name else source, way_in if target == prefix + name else target)
            for source, target in edges
        } | set(inner_edges)
        for door in doors:
            edges = set(_without(door, edges))
        nodes |= {inner: each for inner, each in inner_nodes.items() if inner not in doors}
    for source, target in edges:
        for end in (source, target):
            if end not in nodes:
                raise NeuroroboError(
                    f"an edge leads from `{source}` to `{target}`, and there is no `{end}`; export it again"
                )
    return nodes, frozenset(edges)


def _without(door: str, edges: Iterable[tuple[str, str]]) -> Iterator[tuple[str, str]]:
    """Yield the edges with those through a node joined to one."""
    edges = list(edges)
    before = [source for source, target in edges if target == door]
    behind = [target for source, target in edges if source == door]
    yield from ((source, target) for source in before for target in behind)
    yield from (edge for edge in edges if door not in edge)


def width_of(name: str, node: Any) -> int:
    """Return the channels of an Input or Output; a NeuroroboError unless they are in a row."""
    shape = np.ravel(node.input_type["input"]).tolist()
    width = max(shape, default=0)
    if width < 1 or math.prod(shape) != width:  # a dimension of 1, such as a batch of one, says nothing
        raise NeuroroboError(
            f"the node `{name}` ({kind(node)}) is of the shape {tuple(shape)}; populations are rows here, flatten it"
        )
    return int(width)
