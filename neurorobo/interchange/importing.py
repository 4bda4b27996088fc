"""From a file of NIR to an experiment with a region of the type `spiking_network`, and the weights of that region."""

import os
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from neurorobo.config.document import dump, parse_document
from neurorobo.config.experiment import Experiment
from neurorobo.engine import Layer
from neurorobo.errors import NeuroroboError
from neurorobo.files import write_whole
from neurorobo.interchange.layers import Population, populations
from neurorobo.interchange.neurons import STEP_S
from neurorobo.interchange.notes import Notes, Quantity, population_uniform
from neurorobo.interchange.reading import read_graph
from neurorobo.plugins import Registry
from neurorobo.regions.spiking_network import Network
from neurorobo.regions.spiking_network_config import INPUTS, NetworkConfig
from neurorobo.regions.weights import save_weights
from neurorobo.units import format_quantity, parse_interval

Ports = Mapping[str, Mapping[str, Any]]
"""Ports by name, in the words of an experiment."""

PLAIN_INPUT = "input"
"""What the input is called of which no notes tell."""


@dataclass(frozen=True)
class Imported:
    """An imported region, which has its weights already, and the content of an experiment that runs it.

    ``comments`` stand at its top; all but the first tell what is not as it was in the region that was once exported.
    """

    name: str
    content: dict[str, Any]
    comments: tuple[str, ...]
    region: Network

    @property
    def text(self) -> str:
        """The experiment, as text."""
        return _text(self.comments, self.content)

    @property
    def differences(self) -> tuple[str, ...]:
        """What is not as it was in the region that was once exported."""
        return self.comments[1:]

    def write(self, path: Path) -> Path:
        """Write the experiment, and beside it, under its name, the weights, whose path is returned.

        Raises a NeuroroboError if one of both exists or cannot be written.
        """
        weights = path.with_name(f"{path.stem}.safetensors")
        if path == weights:
            raise NeuroroboError(f"{path} is where the weights will be; call the experiment {path.stem}.yaml")
        for file in (path, weights):
            if os.path.lexists(file):
                raise NeuroroboError(f"{file} exists already, and is left as it is; choose another place with `--out`")
        save_weights(self.region, weights, {"for": f"`{self.name}`, imported from NIR"})
        region = {**self.content["regions"][self.name], "weights": weights.name}
        write_whole(path, _text(self.comments, {**self.content, "regions": {self.name: region}}).encode())
        return weights


def import_network(path: Path, registry: Registry, step_s: float | None = None) -> Imported:
    """Return the network of a file of NIR as a region.

    ``step_s`` is the time step that it was made for, which a file does not tell unless it is ours. Raises a
    NeuroroboError, which names the node, for what layers cannot do, and for what is no file of NIR.
    """
    graph = read_graph(path, registry)
    notes = graph.notes
    if step_s is None:
        step_s = STEP_S if notes is None else notes.step_s
    layers = populations(graph, step_s, {PLAIN_INPUT} if notes is None else {PLAIN_INPUT, *notes.inputs})
    name = re.sub(r"\W", "_", path.stem, flags=re.ASCII)
    name = name if re.match(r"[A-Za-z]", name) else f"network_{name}"
    channels = next(weight.shape[1] for layer in layers.values() for read, weight in layer.weights if read == INPUTS)
    *_, last = layers.values()
    inputs = _ports({} if notes is None else notes.inputs, channels) or {PLAIN_INPUT: _plain(channels)}
    neurons = len(last.membrane.thresholds)
    outputs = _ports({} if notes is None else notes.outputs, neurons) or {"output": _plain(neurons)}
    differences = [] if graph.unread is None else [f"the notes of neurorobo are passed over: {graph.unread}"]
    differences += [] if notes is None else _differences(notes, inputs, outputs)
    content = _content(name, layers, notes, inputs, outputs)
    head = f"From {path.name}, by `neurorobo import`: choose units, ranges and codes, and wire the region."
    comments = tuple(
        "".join(letter if letter.isprintable() else " " for letter in line) for line in (head, *differences)
    )
    experiment = Experiment.from_document(parse_document(_text(comments, content), str(path)), registry)
    config = experiment.regions[name]
    assert isinstance(config, NetworkConfig)
    region = Network(config, experiment.clock, torch.Generator().manual_seed(0))
    for layer, population in zip(region.layers.values(), layers.values(), strict=True):
        assert isinstance(layer, Layer)
        _fill(layer, population)
    return Imported(name, content, comments, region.eval())


def _text(comments: Iterable[str], content: Mapping[str, Any]) -> str:
    return "".join(f"# {line}\n" for line in comments) + dump(content)


def _differences(notes: Notes, inputs: Ports, outputs: Ports) -> Iterator[str]:
    """Yield what our notes tell and a network cannot do, with the ports that it has."""
    for noted, ports in ((notes.inputs, inputs), (notes.outputs, outputs)):
        for name, port in noted.items():
            if ports.get(name) != port.described():
                yield f"the port `{name}` is left out: ports here have all channels, side by side, each of them once"
            elif port.code is None:
                yield f"the code of `{name}` has no name: population_uniform stands in its place"
    for layer in notes.layers if notes.carry != "never" else ():
        if layer.removesuffix(".lif") not in notes.carried:
            yield f"`{layer}` started every window at rest, and goes on here"


def _content(
    name: str, layers: Mapping[str, Population], notes: Notes | None, inputs: Ports, outputs: Ports
) -> dict[str, Any]:
    """Return the experiment."""
    lowest = {name: parse_interval(port["range"], port["unit"]).lo for name, port in inputs.items()}
    return {
        "neurorobo": 1,
        "name": name,
        "time": {"control": "1 s", "spike_step": "1 ms", "window": 50} if notes is None else notes.time(),
        "episode": {"duration": "1 s"},
        "regions": {
            name: {
                "type": "spiking_network",
                "inputs": {
                    port: {**said, "initial": format_quantity(lowest[port], said["unit"])}
                    for port, said in inputs.items()
                },
                "outputs": outputs,
                "layers": {layer: _layer(population) for layer, population in layers.items()},
                "carry": "never" if notes is None else notes.carry,
                "weights": f"{name}.safetensors",
            }
        },
        "steps": [{"window": {"use": name}}],
    }


def _layer(population: Population) -> dict[str, Any]:
    """Return a layer in the words of a file, without what is so by default."""
    membrane = population.membrane
    own = len(set(membrane.thresholds.tolist())) > 1
    neuron: dict[str, Any] = {"type": "lif", "decay": membrane.decay}
    neuron |= {} if own else {"threshold": float(membrane.thresholds[0])}
    neuron["fires"] = "at" if membrane.ties_fire else "above"
    layer: dict[str, Any] = {"neurons": len(membrane.thresholds), "reads": [read for read, _ in population.weights]}
    layer |= {"recurrent": True} if population.recurrent is not None else {}
    layer |= {"bias": True} if population.bias is not None else {}
    layer |= {"own_thresholds": True} if own else {}
    return {**layer, "neuron": neuron}


def _ports(noted: Mapping[str, Quantity], channels: int) -> dict[str, dict[str, Any]]:
    """Return the ports that our notes tell and that are side by side; none unless they have all channels."""
    ports: dict[str, dict[str, Any]] = {}
    end = 0
    for name, port in sorted(noted.items(), key=lambda item: (item[1].channels[0], -len(item[1].channels))):
        if port.channels == tuple(range(end, end + len(port.channels))):
            ports[name] = port.described()
            end += len(port.channels)
    return ports if end == channels else {}


def _plain(channels: int) -> dict[str, Any]:
    """Return a port of which no notes tell: a number from 0 to 1 by rate."""
    return {"unit": "1", "width": 1, "range": "0..1", "code": population_uniform(channels)}


@torch.no_grad()
def _fill(layer: Layer, population: Population) -> None:
    """Give a layer its weights."""
    weights = [weight for _, weight in population.weights]
    weights += [] if population.bias is None else [population.bias[:, np.newaxis]]
    for projection, weight in zip(layer.projections, weights, strict=True):
        projection.weight.copy_(torch.from_numpy(weight))  # type: ignore[operator]
    if layer.recurrent is not None and population.recurrent is not None:
        layer.recurrent.weight.copy_(torch.from_numpy(population.recurrent))
    if layer.threshold is not None:
        thresholds = population.membrane.thresholds.astype(np.float32)
        above = thresholds if population.membrane.ties_fire else np.nextafter(thresholds, np.float32(np.inf))
        layer.threshold.copy_(torch.from_numpy(above))
