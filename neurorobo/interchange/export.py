"""From a region to a file of NIR."""

import io
import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

import neurorobo
from neurorobo.engine import Layer
from neurorobo.errors import NeuroroboError
from neurorobo.files import write_whole
from neurorobo.interchange.library import nir
from neurorobo.interchange.neurons import STEP_S, Membrane, shortest, to_node
from neurorobo.interchange.wiring import INPUT, Wiring, wiring_of
from neurorobo.neurons import LIF
from neurorobo.neurons.generalized_lif import GeneralizedLIF
from neurorobo.plugins import Registry
from neurorobo.regions import Port
from neurorobo.regions.region import Region
from neurorobo.regions.spiking_network_config import NetworkConfig
from neurorobo.units import format_duration

OUTPUT = "output"
NOTES = "neurorobo"
"""The key of the graph's metadata that holds, as JSON, what NIR has no words for."""


def export_region(region: Region, path: Path, registry: Registry) -> list[str]:
    """Write a region as a file of NIR and return what of it could not be said, for the user.

    Raises a NeuroroboError for a region that cannot be said in NIR: with neurons other than LIF, numbers as inputs,
    outputs of several layers, learning, or steps that do more with spikes than to wire them.
    """
    graph, unsaid = to_graph(region, registry)
    write_graph(graph, path)
    return unsaid


def write_graph(graph: Any, path: Path) -> None:
    """Write a graph of NIR, and the folders that it is in; raises a NeuroroboError."""
    content = io.BytesIO()
    nir().write(content, graph)
    write_whole(path, content.getvalue())


def to_graph(region: Region, registry: Registry) -> tuple[Any, list[str]]:
    """Return a region as a graph of NIR, and what of it could not be said; raises as :func:`export_region` does."""
    package, wiring = nir(), wiring_of(region)
    last = _last(wiring)
    needed = _needed(wiring, last)
    nodes: dict[str, Any] = {INPUT: package.Input({"input": np.array([_channels(region.input_ports)])})}
    edges: list[tuple[str, str]] = []
    membranes: dict[str, Membrane] = {}
    for name in needed:
        layer = wiring.layers[name]
        membranes[name] = _membrane(name, layer, ties_fire=_ties_fire(region, name))
        nodes[_node(name)] = to_node(membranes[name])
        for source, node in _synapses(name, layer, wiring, nodes[INPUT].input_type["input"][0]):
            synapses = f"{name}.from_{source}"
            nodes[synapses] = node
            edges += [(source if source == INPUT else _node(source), synapses), (synapses, _node(name))]
    nodes[OUTPUT] = package.Output({"output": np.array([wiring.layers[last].neurons])})
    edges.append((_node(last), OUTPUT))
    unsaid = [f"the output `{name}`, which carries numbers" for name in wiring.numeric]
    unsaid += [f"the layer `{name}`, which no spiking output reads" for name in wiring.layers if name not in needed]
    notes = _notes(region, wiring, membranes, registry)
    return package.NIRGraph(nodes, edges, metadata={NOTES: json.dumps(notes)}), unsaid


def _node(layer: str) -> str:
    return f"{layer}.lif"


def _channels(ports: Mapping[str, Port]) -> int:
    return sum(port.channels for port in ports.values())


def _last(wiring: Wiring) -> str:
    """Return the layer that the outputs read."""
    if INPUT in wiring.layers:
        raise NeuroroboError(f"its layer `{INPUT}` is called as the node of all inputs; call it otherwise")
    names = dict.fromkeys(layer for layer, _ in wiring.outputs.values())
    if len(names) != 1:
        raise NeuroroboError(
            f"its outputs read the layers {' and '.join(f'`{name}`' for name in names)}, and a graph has one output"
            if names
            else "none of its outputs carries spikes"
        )
    return next(iter(names))


def _needed(wiring: Wiring, last: str) -> list[str]:
    """Return the layers that lead to the last one, in order."""
    needed = {last}
    for name in reversed(wiring.layers):
        if name in needed:
            needed |= {source[0] for columns in wiring.readings[name] for source in columns if source is not None}
    return [name for name in wiring.layers if name in needed]


def _membrane(name: str, layer: Layer, *, ties_fire: bool) -> Membrane:
    neuron = layer.neuron
    if isinstance(neuron, GeneralizedLIF):
        return _reset_at_once(name, layer.neurons, neuron, ties_fire=ties_fire)
    if not isinstance(neuron, LIF):
        raise NeuroroboError(f"the neurons of its layer `{name}` are of the model {type(neuron).__name__}, not LIF")
    if neuron.rectify:
        raise NeuroroboError(
            f"the neurons of its layer `{name}` are spiking neural units, whose potential is rectified; NIR has none"
        )
    own = layer.threshold
    thresholds = np.full(layer.neurons, neuron.threshold) if own is None else own.detach().double().numpy()
    return Membrane(neuron.decay, _as_configured(thresholds, ties_fire=ties_fire), ties_fire)


def _reset_at_once(name: str, neurons: int, neuron: GeneralizedLIF, *, ties_fire: bool) -> Membrane:
    """Return neurons whose potential is ours times the gain of their input, by which the threshold is divided."""
    faults = {
        "have a synaptic current": neuron.synapse_decay is not None,
        "adapt their threshold": neuron.adaptation is not None,
        "are reset by their threshold and not to zero": neuron.reset != "zero",
    }
    for fault, holds in faults.items():
        if holds:
            raise NeuroroboError(f"the neurons of its layer `{name}` {fault}; a LIF node of NIR does not")
    thresholds = _as_configured(np.full(neurons, neuron.threshold), ties_fire=ties_fire)
    return Membrane(neuron.decay, thresholds / neuron.input_gain, ties_fire)


def _as_configured(thresholds: NDArray[np.float64], *, ties_fire: bool) -> NDArray[np.float64]:
    """Return the thresholds that a file names; neurons that fire above them have the number just above."""
    if ties_fire:
        return thresholds
    return shortest(np.nextafter(thresholds.astype(np.float32), np.float32(0)))


def _ties_fire(region: Region, layer: str) -> bool:
    """Return whether the neurons of a layer fire at their threshold; the configuration knows, a neuron does not."""
    config = region.config
    says = config.layers[layer] if isinstance(config, NetworkConfig) else config
    return getattr(getattr(says, "neuron", None), "fires", "at") == "at"


def _synapses(name: str, layer: Layer, wiring: Wiring, channels: int) -> Iterator[tuple[str, Any]]:
    """Yield each source of a layer, and the synapses from there as a node; the first one has the constant currents."""
    weights: dict[str, NDArray[np.float32]] = {}
    bias: NDArray[np.float32] = np.zeros(layer.neurons, np.float32)
    for projection, columns in zip(layer.projections, wiring.readings[name], strict=True):
        with torch.no_grad():
            matrix = projection.matrix().float().numpy()  # type: ignore[operator]
        for source in dict.fromkeys(None if each is None else each[0] for each in columns):
            here = [number for number, each in enumerate(columns) if (each and each[0]) == source]
            if source is None:
                bias += matrix[:, here].sum(1)
                continue
            if source not in weights:
                width = channels if source == INPUT else wiring.layers[source].neurons
                weights[source] = np.zeros((layer.neurons, width), np.float32)
            read = [each[1] for each in columns if each is not None and each[0] == source]
            np.add.at(weights[source].T, read, matrix[:, here].T)
    if not weights:  # it has constant currents alone, and a node hears of them from some source
        weights[INPUT] = np.zeros((layer.neurons, channels), np.float32)
    if layer.recurrent is not None:
        weights[name] = layer.recurrent.matrix().detach().float().numpy()
    for number, (source_name, weight) in enumerate(weights.items()):
        if number == 0 and bias.any():
            yield source_name, nir().Affine(weight, bias)
        else:
            yield source_name, nir().Linear(weight)


def _notes(region: Region, wiring: Wiring, membranes: Mapping[str, Membrane], registry: Registry) -> dict[str, Any]:
    """Return what NIR has no words for: steps, windows, quantities, codes, exact thresholds, whose state is kept."""
    inputs: dict[str, Any] = {}
    channel = 0
    for name, port in region.input_ports.items():
        inputs[name] = _quantity(port, list(range(channel, channel := channel + port.channels)), registry)
    return {
        "version": neurorobo.__version__,
        "step_s": STEP_S,
        "spike_step": format_duration(region.clock.spike_step_ns),
        "window": region.clock.window,
        "carry": region.config.carry,
        "carried": sorted(wiring.carried),
        "inputs": inputs,
        "outputs": {
            name: _quantity(region.output_ports[name], numbers, registry)
            for name, (_, numbers) in wiring.outputs.items()
        },
        "layers": {
            _node(name): {
                "decay": membrane.decay,
                "thresholds": membrane.thresholds.tolist(),
                "fires": "at" if membrane.ties_fire else "above",
            }
            for name, membrane in membranes.items()
        },
    }


def _quantity(port: Port, channels: list[int], registry: Registry) -> dict[str, Any]:
    """Return a port and its channels in the Input or Output; without a code if no file of ours can say it."""
    code = port.code
    assert code is not None
    said: dict[str, Any] = {"unit": port.unit, "width": port.width, "lo": code.lo, "hi": code.hi, "channels": channels}
    name = re.sub(r"(?<!^)(?=[A-Z])", "_", type(code).__name__).lower()
    if f"core.{name}" in registry.names("code"):
        config = registry.get("code", name)(neurons=code.neurons)
        if config.build(code.lo, code.hi) == code:
            said["code"] = {"type": name, "neurons": code.neurons}
    return said
