"""How a region is wired, found out by asking it.

The region runs one step in which its circuit is replaced by one that computes nothing: each channel of an input, and
each neuron of a layer, says its own number in place of spikes. Which number arrives where tells what the layers read
and what the ports send, for any region that does no more with spikes than to split and to join them. A region that
computes with them may happen to give such numbers too; so what was found is checked with random spikes.
"""

import copy
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from itertools import count

import torch
from torch import Tensor

from neurorobo.engine import Circuit, Layer, Probe
from neurorobo.errors import NeuroroboError
from neurorobo.regions.plastic import Plastic
from neurorobo.regions.region import Region

STEPS = 2
"""In the second step all numbers are other ones, so that a number that is computed is no number that is said."""

RATES = (0.1, 0.3, 0.5, 0.7, 0.9)
"""The shares of channels that fire in a step of the random spikes."""

BATCH = 2

INPUT = "input"
"""The source that is all inputs of the region, side by side in the order of its ports."""


Source = tuple[str, int] | None
"""Where a spike comes from: `INPUT` or a layer, and the channel there; None stands for a spike in every step."""


@dataclass(frozen=True)
class Wiring:
    """A region as layers and what they read.

    ``readings`` has the sources of each column of each projection of each layer; ``outputs`` the layer of each output
    port and the numbers of its neurons; ``numeric`` the output ports that carry no spikes; ``carried`` the layers whose
    state the region keeps from one window to the next.
    """

    layers: dict[str, Layer]
    readings: dict[str, list[list[Source]]]
    outputs: dict[str, tuple[str, list[int]]]
    numeric: tuple[str, ...]
    carried: frozenset[str]


def wiring_of(region: Region) -> Wiring:
    """Return how a region is wired; a NeuroroboError says what it does that is more than wiring."""
    if isinstance(region, Plastic):
        raise NeuroroboError("it learns while it runs, which NIR cannot say; export the region that it extends")
    for name, port in region.input_ports.items():
        if port.code is None:
            raise NeuroroboError(f"its input `{name}` carries numbers, and NIR knows spikes only")
    found = {name: value for name, value in vars(region).items() if isinstance(value, Circuit)}
    if len(found) != 1:
        raise NeuroroboError(
            "it holds no circuit of spiking layers"
            if not found
            else f"it holds {len(found)} circuits, and NIR does not say when which of them runs"
        )
    [(attribute, circuit)] = found.items()
    layers = circuit.layers
    if spare := [
        name for name, module in region.named_modules() if isinstance(module, Layer) and module not in layers.values()
    ]:
        raise NeuroroboError(f"the layer `{spare[0]}` is no part of its circuit, so that nothing tells what it reads")
    numbers = _Numbers(region, circuit)
    listener, said = _heard(region, attribute, numbers.of_ports, numbers.of_layers)
    sources = {name: numbers.heard(name, listener.inputs[name]) for name in circuit.inputs}
    outputs = {name: numbers.layer(name, said[name]) for name, port in region.output_ports.items() if port.code}
    _check(region, attribute, sources, outputs)
    return Wiring(
        layers,
        _readings(circuit, sources),
        outputs,
        tuple(name for name, port in region.output_ports.items() if port.code is None),
        frozenset(listener.carried),
    )


def _heard(
    region: Region, attribute: str, of_ports: Mapping[str, Tensor], of_layers: Mapping[str, Tensor]
) -> tuple["_Listener", Mapping[str, Tensor]]:
    """Run one step with a listener as the circuit, and return it and the outputs; a NeuroroboError if it fails."""
    twin = copy.copy(region)
    listener = _Listener(vars(region)[attribute], of_layers)
    vars(twin)[attribute] = listener
    batch = next(iter(of_ports.values())).shape[1]
    try:
        with torch.no_grad():
            outputs, _ = twin.step(of_ports, twin.init_state(batch))
    except NeuroroboError:
        raise
    except Exception as error:
        raise NeuroroboError(f"it does more with spikes than to wire them ({type(error).__name__}: {error})") from error
    if not listener.inputs:
        raise NeuroroboError("its step does not run its circuit")
    return listener, outputs


def _check(
    region: Region,
    attribute: str,
    sources: Mapping[str, list[Source]],
    outputs: Mapping[str, tuple[str, list[int]]],
) -> None:
    """Raise a NeuroroboError unless random spikes, rare and frequent ones, arrive where the wiring says."""
    generator = torch.Generator().manual_seed(0)
    for rate in RATES:

        def random(channels: int, rate: float = rate) -> Tensor:
            draws = torch.rand(region.clock.window, BATCH, channels, generator=generator)
            return (draws < rate).to(torch.get_default_dtype())

        of_ports = {name: random(port.channels) for name, port in region.input_ports.items()}
        of_layers = {name: random(layer.neurons) for name, layer in vars(region)[attribute].layers.items()}
        listener, sent = _heard(region, attribute, of_ports, of_layers)
        spikes = {INPUT: torch.cat([*of_ports.values()], dim=-1), **of_layers}
        ones = torch.ones(region.clock.window, BATCH)
        for name, each in sources.items():
            expected = [ones if source is None else spikes[source[0]][..., source[1]] for source in each]
            if not torch.equal(listener.inputs[name], torch.stack(expected, dim=-1)):
                raise _something_else(name)
        for name, (layer, neurons) in outputs.items():
            if not torch.equal(sent[name], of_layers[layer][..., neurons]):
                raise _something_else(name)


def _something_else(name: str) -> NeuroroboError:
    return NeuroroboError(f"it makes of spikes something else before `{name}`")


class _Numbers:
    """The numbers of all channels and neurons, which stand for spikes (`STEPS`, 1, channels)."""

    def __init__(self, region: Region, circuit: Circuit) -> None:
        free = count(2)  # 0 and 1 would be spikes
        self.sources = [(INPUT, channel) for channel in range(sum(p.channels for p in region.input_ports.values()))]
        self.sources += [(name, neuron) for name, layer in circuit.layers.items() for neuron in range(layer.neurons)]
        self.of_ports = {name: self._said(free, port.channels) for name, port in region.input_ports.items()}
        self.of_layers = {name: self._said(free, layer.neurons) for name, layer in circuit.layers.items()}

    def _said(self, free: "count[int]", channels: int) -> Tensor:
        first = torch.tensor([next(free) for _ in range(channels)], dtype=torch.get_default_dtype())
        return torch.stack([first + step * len(self.sources) for step in range(STEPS)]).unsqueeze(1)

    def heard(self, name: str, spikes: Tensor) -> list[Source]:
        """Return where each channel comes from, or None where there is a spike in every step."""
        if spikes.dim() != 3 or spikes.shape[:2] != (STEPS, 1):
            raise _something_else(name)
        sources: list[Source] = []
        for now, then in spikes[:, 0].t().tolist():
            place = int(now) - 2
            if now == then == 1:
                sources.append(None)
            elif now == place + 2 and then == now + len(self.sources) and 0 <= place < len(self.sources):
                sources.append(self.sources[place])
            else:
                raise _something_else(name)
        return sources

    def layer(self, port: str, spikes: Tensor) -> tuple[str, list[int]]:
        """Return the layer that an output port reads, and which of its neurons."""
        sources = [source for source in self.heard(port, spikes) if source is not None and source[0] != INPUT]
        names = {name for name, _ in sources}
        if len(sources) != spikes.shape[2] or len(names) != 1:
            raise NeuroroboError(f"its output `{port}` is not of the neurons of one layer")
        return names.pop(), [neuron for _, neuron in sources]


class _Listener:
    """Stands for a circuit: says what it was told for each layer, and keeps what it was given."""

    def __init__(self, circuit: Circuit, of_layers: Mapping[str, Tensor]) -> None:
        self.layers = circuit.layers
        self.of_layers = of_layers
        self.inputs: dict[str, Tensor] = {}
        self.carried: Collection[str] = ()

    def __call__(
        self,
        inputs: Mapping[str, Tensor],
        state: Mapping[str, Tensor] | None = None,
        wanted: Collection[str] | None = None,
        probe: Probe | None = None,
    ) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
        if self.inputs:
            raise NeuroroboError("it runs its circuit several times in a step")
        self.inputs = dict(inputs)
        self.carried = () if state is None else tuple(state)
        said = self.of_layers
        return {name: said[name] for name in (said if wanted is None else wanted)}, dict(state or {})


def _readings(circuit: Circuit, sources: Mapping[str, list[Source]]) -> dict[str, list[list[Source]]]:
    known = dict(sources)
    readings: dict[str, list[list[Source]]] = {}
    for name, groups in circuit.readings.items():
        readings[name] = [[source for read in group for source in known[read]] for group in groups]
        known[name] = [(name, neuron) for neuron in range(circuit.layers[name].neurons)]
    return readings
