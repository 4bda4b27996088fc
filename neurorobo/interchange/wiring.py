"""How a region is wired, found out by asking it.

The region runs one step in which its circuit is replaced by one that computes nothing: each channel of an input, and
each neuron of a layer, says its own number in place of spikes. Which number arrives where tells what the layers read
and what the ports send, for any region that does no more with spikes than to split and to join them.
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
    listener = _Listener(circuit, numbers)
    twin = copy.copy(region)
    vars(twin)[attribute] = listener
    try:
        with torch.no_grad():
            outputs, _ = twin.step(numbers.of_ports, twin.init_state(1))
    except NeuroroboError:
        raise
    except Exception as error:
        raise NeuroroboError(f"it does more with spikes than to wire them ({type(error).__name__}: {error})") from error
    if not listener.inputs:
        raise NeuroroboError("its step does not run its circuit")
    return Wiring(
        layers,
        _readings(circuit, listener, numbers),
        {name: numbers.layer(name, outputs[name]) for name, port in region.output_ports.items() if port.code},
        tuple(name for name, port in region.output_ports.items() if port.code is None),
        frozenset(listener.carried),
    )


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
            raise NeuroroboError(f"it makes of spikes something else before `{name}`")
        sources: list[Source] = []
        for now, then in spikes[:, 0].t().tolist():
            place = int(now) - 2
            if now == then == 1:
                sources.append(None)
            elif now == place + 2 and then == now + len(self.sources) and 0 <= place < len(self.sources):
                sources.append(self.sources[place])
            else:
                raise NeuroroboError(f"it makes of spikes something else before `{name}`")
        return sources

    def layer(self, port: str, spikes: Tensor) -> tuple[str, list[int]]:
        """Return the layer that an output port reads, and which of its neurons."""
        sources = [source for source in self.heard(port, spikes) if source is not None and source[0] != INPUT]
        names = {name for name, _ in sources}
        if len(sources) != spikes.shape[2] or len(names) != 1:
            raise NeuroroboError(f"its output `{port}` is not of the neurons of one layer")
        return names.pop(), [neuron for _, neuron in sources]


class _Listener:
    """Stands for a circuit: says numbers, and keeps what it was given."""

    def __init__(self, circuit: Circuit, numbers: _Numbers) -> None:
        self.layers = circuit.layers
        self.numbers = numbers
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
        said = self.numbers.of_layers
        return {name: said[name] for name in (said if wanted is None else wanted)}, dict(state or {})


def _readings(circuit: Circuit, listener: _Listener, numbers: _Numbers) -> dict[str, list[list[Source]]]:
    known = {name: numbers.heard(name, listener.inputs[name]) for name in circuit.inputs}
    readings: dict[str, list[list[Source]]] = {}
    for name, groups in circuit.readings.items():
        readings[name] = [[source for read in group for source in known[read]] for group in groups]
        known[name] = [(name, neuron) for neuron in range(circuit.layers[name].neurons)]
    return readings
