"""What a region's windows cost: spikes, synaptic operations and energy."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from neurorobo.engine import Circuit, Probe
from neurorobo.graph.plan import Edge, Use
from neurorobo.regions.region import Region
from neurorobo.synapses import FanIn, Projection

Array = NDArray[np.float64]

ACCUMULATE_PJ = 0.9
MULTIPLY_ACCUMULATE_PJ = 4.6
"""32-bit floating point at 45 nm, without memory: Horowitz, ISSCC 2014, as used to compare spiking networks."""


@dataclass(frozen=True)
class Synapses:
    """A projection of a region: what it reads, onto which layer, and how many synapses each source has there."""

    reads: tuple[str, ...]
    layer: str
    fan_out: Tensor

    @property
    def name(self) -> str:
        """Return ``nuclei <- purkinje``."""
        return f"{self.layer} <- {', '.join(self.reads)}"

    @property
    def count(self) -> int:
        """How many synapses there are."""
        return int(self.fan_out.sum())

    def operations(self, spikes: Mapping[str, Tensor]) -> Tensor:
        """Return the synaptic operations (batch) of spike counts (batch, neurons) by name: spikes times fan-out."""
        return torch.cat([spikes[name] for name in self.reads], dim=1).double() @ self.fan_out.double()


def circuit_of(region: Region) -> Circuit | None:
    """Return the circuit of a spiking region."""
    return next((value for value in vars(region).values() if isinstance(value, Circuit)), None)


def synapses(circuit: Circuit) -> Iterator[Synapses]:
    """Yield all projections of a circuit, recurrent ones as well."""
    for name, readings in circuit.readings.items():
        layer = circuit.layers[name]
        for projection, reads in zip(layer.projections, readings, strict=True):
            assert isinstance(projection, Projection)
            yield Synapses(reads, name, _fan_out(projection))
        if layer.recurrent is not None:
            yield Synapses((name,), name, _fan_out(layer.recurrent))


def _fan_out(projection: Projection) -> Tensor:
    if isinstance(projection, FanIn):
        return projection.source_index.flatten().bincount(minlength=projection.sources)
    return torch.full((projection.sources,), projection.targets)


def spiking_pJ(operations: float, updates: float) -> float:
    """Return the energy of synaptic operations, an accumulation each, and neuron updates, a multiplication each."""
    return operations * ACCUMULATE_PJ + updates * MULTIPLY_ACCUMULATE_PJ


def dense_pJ(multiplications: float) -> float:
    """Return the energy of units that are not spiking: a multiplication and accumulation for each synapse."""
    return multiplications * MULTIPLY_ACCUMULATE_PJ


@dataclass
class Window:
    """One use of a region for a batch: spike counts (batch, neurons) of each layer, and operations by projection."""

    region: str
    spikes: Mapping[str, Tensor]
    operations: Mapping[str, Tensor]
    running: NDArray[np.bool_]


@dataclass
class Listener:
    """Watches a brain: keeps the spike counts and synaptic operations of every window of its spiking regions."""

    synapses: Mapping[str, list[Synapses]]
    running: NDArray[np.bool_]
    windows: list[Window] = field(default_factory=list)
    _heard: dict[str, Tensor] = field(default_factory=dict)

    def probe(self, use: Use, *, last: bool) -> Probe | None:
        """Count the spikes of each layer of a use."""
        self._heard = {}

        def hear(layer: str, spikes: Tensor) -> None:
            self._heard[layer] = spikes.sum(0)

        return hear

    def used(
        self,
        use: Use,
        iteration: int,
        inputs: Mapping[str, Tensor],
        outputs: Mapping[str, Tensor],
        numbers: Mapping[str, Tensor],
    ) -> None:
        """Keep a use of a spiking region."""
        if use.region in self.synapses:
            spikes = {**{name: value.sum(0) for name, value in inputs.items() if value.dim() == 3}, **self._heard}
            operations = {one.name: one.operations(spikes) for one in self.synapses[use.region]}
            self.windows.append(Window(use.region, self._heard, operations, self.running))

    def saturated(self, edge: Edge, count: Tensor) -> None:
        """Take no note."""
