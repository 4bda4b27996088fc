"""From a graph of NIR to layers: who excites whom, with which weights."""

import re
from collections.abc import Collection
from dataclasses import dataclass, replace
from graphlib import CycleError, TopologicalSorter

import numpy as np
from numpy.typing import NDArray

from neurorobo.errors import NeuroroboError
from neurorobo.interchange.neurons import Membrane, from_node, refusal, to_node
from neurorobo.interchange.reading import NEURONS, SYNAPSES, Graph, kind, width_of
from neurorobo.regions.spiking_network_config import INPUTS

Matrix = NDArray[np.float32]


@dataclass(frozen=True)
class Population:
    """A layer: what it reads, by weights (neurons, sources), and of what neurons it is."""

    weights: tuple[tuple[str, Matrix], ...]
    recurrent: Matrix | None
    bias: Matrix | None
    membrane: Membrane


def populations(graph: Graph, step_s: float, ports: Collection[str]) -> dict[str, Population]:
    """Return the layers of a graph by name, in order; the last one sends the outputs, `INPUTS` stands for the inputs.

    No layer is called as one of the input ``ports``. Raises a NeuroroboError, which names the node, for what layers
    cannot do.
    """
    way_in, way_out = (_only(graph, each) for each in ("Input", "Output"))
    sources = {way_in: width_of(way_in, graph.nodes[way_in])} | {name: 0 for name in graph.of(*NEURONS)}
    drives = {name: _drives(graph, name) for name in graph.of(*NEURONS)}
    for name, node in graph.nodes.items():
        if name != way_out and not graph.out_of(name):
            raise refusal(name, kind(node), "it leads nowhere", "leave it out")
    last = graph.into(way_out)
    if len(last) != 1 or kind(graph.nodes[last[0]]) not in NEURONS:
        raise refusal(way_out, "Output", "it is not of the spikes of one node", "lead one LIF node to it, and no other")
    names = _names([way_in, *drives], ports)
    order = _order(drives)
    found: dict[str, Population] = {}
    for name in order:
        found[names[name]], sources[name] = _population(graph, name, drives[name], sources, names, step_s)
    if width_of(way_out, graph.nodes[way_out]) != sources[last[0]]:
        raise refusal(
            way_out,
            "Output",
            f"it has {width_of(way_out, graph.nodes[way_out])} channels, and `{last[0]}` {sources[last[0]]} neurons",
            "export it again",
        )
    return found


def _only(graph: Graph, wanted: str) -> str:
    found = graph.of(wanted)
    if len(found) != 1:
        raise NeuroroboError(f"a network has one {wanted} here, and the file has {len(found)}; join them to one")
    return found[0]


def _drives(graph: Graph, name: str) -> dict[str, str]:
    """Return the synapses that lead to a population, and what each reads."""
    node = graph.nodes[name]
    drives: dict[str, str] = {}
    for synapses in graph.into(name):
        if kind(graph.nodes[synapses]) not in SYNAPSES:
            raise refusal(
                name, kind(node), f"`{synapses}` leads to it without weights", "put a Linear node between them"
            )
        before = graph.into(synapses)
        said = " and ".join(f"`{each}`" for each in before) or "nothing"
        if len(before) != 1 or kind(graph.nodes[before[0]]) not in (*NEURONS, "Input"):
            raise refusal(
                synapses,
                kind(graph.nodes[synapses]),
                f"it reads {said}, where the spikes of one node are wanted",
                "give each source weights of its own, and join those that follow one another",
            )
        drives[synapses] = before[0]
    if not drives:
        raise refusal(name, kind(node), "nothing leads to it", "leave it out")
    if sum(source == name for source in drives.values()) > 1:
        raise refusal(name, kind(node), "it excites itself by several nodes", "add up their weights")
    if all(source == name for source in drives.values()):
        raise refusal(name, kind(node), "nothing but itself leads to it", "leave it out")
    return drives


def _order(drives: dict[str, dict[str, str]]) -> list[str]:
    before = {name: [each for each in of.values() if each in drives and each != name] for name, of in drives.items()}
    try:
        return list(TopologicalSorter(before).static_order())
    except CycleError as error:
        circle = " -> ".join(f"`{name}`" for name in error.args[1])
        raise NeuroroboError(
            f"the nodes {circle} excite one another in a circle, and only neurons of one layer can; join them to one "
            "node"
        ) from None


def _population(
    graph: Graph, name: str, drives: dict[str, str], sources: dict[str, int], names: dict[str, str], step_s: float
) -> tuple[Population, int]:
    """Return a population and how many neurons it has."""
    membrane = _membrane(graph, name, step_s)
    sizes = {each: np.shape(graph.nodes[each].weight) for each in drives}
    neurons = max(len(membrane.thresholds), next(iter(sizes.values()))[0])  # of one number, for all neurons
    if len(membrane.thresholds) == 1:
        membrane = replace(membrane, thresholds=np.repeat(membrane.thresholds, neurons))
    for synapses, source in drives.items():
        wanted = (neurons, neurons if source == name else sources[source])
        if sizes[synapses] != wanted:
            raise refusal(
                synapses,
                kind(graph.nodes[synapses]),
                f"its weights are of {sizes[synapses]}, and from `{source}` to `{name}` {wanted} are needed",
                "export it again",
            )
    weights: list[tuple[str, Matrix]] = []
    recurrent: Matrix | None = None
    bias: Matrix = np.zeros(neurons, np.float32)
    for synapses, source in drives.items():
        node = graph.nodes[synapses]
        matrix = _finite(synapses, kind(node), "weight", node.weight)
        if kind(node) == "Affine":
            extra = _finite(synapses, "Affine", "bias", node.bias)
            if extra.size not in (1, neurons):
                raise refusal(
                    synapses, "Affine", f"`bias` is of {extra.shape}, {(neurons,)} is needed", "export it again"
                )
            bias += extra.reshape(-1)
        if source == name:
            recurrent = matrix
        else:
            weights.append((names[source], matrix))
    population = Population(tuple(weights), recurrent, bias if bias.any() else None, membrane)
    return population, neurons


def _finite(name: str, of: str, parameter: str, values: object) -> Matrix:
    numbers = np.asarray(values)
    if numbers.dtype.kind not in "fiu" or not np.isfinite(numbers).all():
        raise refusal(name, of, f"`{parameter}` holds a value that is not a number", "export it again")
    return numbers.astype(np.float32)


def _membrane(graph: Graph, name: str, step_s: float) -> Membrane:
    """Return the neurons of a node, as the notes have them if it is the very node that we would write for those."""
    node = graph.nodes[name]
    read = from_node(name, node, step_s)
    noted = None if graph.notes is None else graph.notes.layers.get(name)
    if noted is None:
        return read
    ours = Membrane(noted.decay, np.array(noted.thresholds), noted.fires == "at")
    with np.errstate(over="ignore"):
        theirs = to_node(ours, step_s)
    same = all(np.array_equal(value, getattr(node, key)) for key, value in vars(theirs).items() if key in _COMPARED)
    return ours if type(theirs) is type(node) and same else read


_COMPARED = ("tau", "r", "v_leak", "v_threshold", "v_reset")


def _names(nodes: list[str], ports: Collection[str]) -> dict[str, str]:
    """Return a name for each population that can stand in a file; the first node is the Input."""
    names = {nodes[0]: INPUTS}
    for node in nodes[1:]:
        name = re.sub(r"\W", "_", re.sub(r"[._](lif|if)$", "", node), flags=re.ASCII).strip("_")
        name = name if re.match(r"[A-Za-z]", name) else f"layer_{name}"
        while name in ports or name in names.values():
            name += "_"
        names[node] = name
    return names
