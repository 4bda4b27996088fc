"""From a file of NIR to an experiment with a region of the type `spiking_network`, and the weights of that region."""

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
from neurorobo.interchange.reading import read_graph
from neurorobo.plugins import Registry
from neurorobo.regions.spiking_network import Network
from neurorobo.regions.spiking_network_config import INPUTS, NetworkConfig
from neurorobo.regions.weights import save_weights
from neurorobo.units import format_quantity, parse_interval


@dataclass(frozen=True)
class Imported:
    """An experiment, as text, that runs the imported region; ``region`` has its weights already.

    ``differences`` tell what is not as it was in the region that was once exported.
    """

    name: str
    text: str
    region: Network
    differences: tuple[str, ...]

    def write(self, path: Path) -> Path:
        """Write the experiment, and beside it the weights, whose path is returned; raises NeuroroboError."""
        weights = path.with_name(f"{self.name}.safetensors")
        save_weights(self.region, weights, {"for": f"`{self.name}`, imported from NIR"})
        write_whole(path, self.text.encode())
        return weights


def import_network(path: Path, registry: Registry, step_s: float | None = None) -> Imported:
    """Return the network of a file of NIR as a region.

    ``step_s`` is the time step that it was made for, which a file does not tell unless it is ours. Raises a
    NeuroroboError, which names the node, for what layers cannot do, and for what is no file of NIR.
    """
    graph = read_graph(path)
    if step_s is None:
        noted = graph.notes.get("step_s")
        step_s = noted if isinstance(noted, float) and noted > 0 else STEP_S
    layers = populations(graph, step_s)
    name = re.sub(r"\W", "_", path.stem, flags=re.ASCII)
    name = name if re.match(r"[A-Za-z]", name) else f"network_{name}"
    differences = tuple(_differences(graph.notes))
    text = _text(path, name, layers, graph.notes, differences)
    experiment = Experiment.from_document(parse_document(text, str(path)), registry)
    config = experiment.regions[name]
    assert isinstance(config, NetworkConfig)
    region = Network(config, experiment.clock, torch.Generator().manual_seed(0))
    for layer, population in zip(region.layers.values(), layers.values(), strict=True):
        assert isinstance(layer, Layer)
        _fill(layer, population)
    return Imported(name, text, region.eval(), differences)


def _differences(notes: Mapping[str, Any]) -> Iterator[str]:
    """Yield what our notes tell and a network cannot do."""
    for side in ("inputs", "outputs"):
        for name, said in notes.get(side, {}).items():
            if "code" not in said:
                yield f"the code of `{name}` has no name: population_uniform stands in its place"
    carried = notes.get("carried", [])
    for layer in notes.get("layers", {}) if notes.get("carry", "never") != "never" else ():
        if layer.removesuffix(".lif") not in carried:
            yield f"`{layer}` started every window at rest, and goes on here"


def _text(
    path: Path, name: str, layers: Mapping[str, Population], notes: Mapping[str, Any], differences: Iterable[str]
) -> str:
    """Return the experiment: quantities and codes as our notes have them, or numbers from 0 to 1 by rate."""
    channels = next(weight.shape[1] for layer in layers.values() for read, weight in layer.weights if read == INPUTS)
    *_, last = layers.values()
    inputs = _ports(notes.get("inputs"), channels) or {"input": _port({}, channels)}
    outputs = _ports(notes.get("outputs"), len(last.membrane.thresholds)) or {
        "output": _port({}, len(last.membrane.thresholds))
    }
    for port in inputs.values():
        port["initial"] = format_quantity(parse_interval(port["range"], port["unit"]).lo, port["unit"])
    experiment = {
        "neurorobo": 1,
        "name": name,
        "time": {"control": "1 s", "spike_step": notes.get("spike_step", "1 ms"), "window": notes.get("window", 50)},
        "episode": {"duration": "1 s"},
        "regions": {
            name: {
                "type": "spiking_network",
                "inputs": inputs,
                "outputs": outputs,
                "layers": {layer: _layer(population) for layer, population in layers.items()},
                "carry": notes.get("carry", "never"),
                "weights": f"{name}.safetensors",
            }
        },
        "steps": [{"window": {"use": name}}],
    }
    head = f"From {path.name}, by `neurorobo import`: choose units, ranges and codes, and wire the region."
    return "".join(f"# {line}\n" for line in (head, *differences)) + dump(experiment)


def _layer(population: Population) -> dict[str, Any]:
    """Return a layer in the words of a file, without what is so by default."""
    membrane = population.membrane
    own = len(set(membrane.thresholds.tolist())) > 1
    neuron: dict[str, Any] = {"type": "lif", "decay": membrane.decay}
    if not own:
        neuron |= {"threshold": float(membrane.thresholds[0]), "fires": "at" if population.ties_fire else "above"}
    layer: dict[str, Any] = {"neurons": len(membrane.thresholds), "reads": [read for read, _ in population.weights]}
    layer |= {"recurrent": True} if population.recurrent is not None else {}
    layer |= {"bias": True} if population.bias is not None else {}
    layer |= {"own_thresholds": True} if own else {}
    return {**layer, "neuron": neuron}


def _ports(noted: object, channels: int) -> dict[str, dict[str, Any]] | None:
    """Return the ports that our notes tell, those that share neurons once; None unless they have all channels."""
    ports: dict[str, dict[str, Any]] = {}
    next_channel = 0
    try:
        for name, said in noted.items():  # type: ignore[attr-defined]
            if said["channels"][0] == next_channel:
                ports[name] = _port(said, len(said["channels"]))
                next_channel = said["channels"][-1] + 1
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError, NeuroroboError):  # none, or not ours
        return None
    return ports if next_channel == channels else None


def _port(said: Mapping[str, Any], channels: int) -> dict[str, Any]:
    """Return a port in the words of a file; of a quantity or a code that is not known, the plainest."""
    unit, width = said.get("unit", "1"), said.get("width", 1)
    return {
        "unit": unit,
        "width": width,
        "range": f"{format_quantity(said.get('lo', 0.0), '1')}..{format_quantity(said.get('hi', 1.0), unit)}",
        "code": said.get("code", {"type": "population_uniform", "neurons": channels // width}),
    }


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
        above = thresholds if population.ties_fire else np.nextafter(thresholds, np.float32(np.inf))
        layer.threshold.copy_(torch.from_numpy(above))
