"""What a region does while it runs: NeuroBench's workload metrics, counted window by window."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import astuple, dataclass, replace
from operator import add
from typing import Any

import torch
from torch import Tensor, nn

from neurorobo.engine import Layer
from neurorobo.measures.connections import Connections, biases, circuits, connections, fan_out, layers
from neurorobo.regions.plastic import Plastic
from neurorobo.regions.region import Region
from neurorobo.synapses import Projection


@dataclass
class Work:
    """Counts of windows, by NeuroBench's names and definitions (Yik et al. 2025); they add up.

    Of each step of each window, ``activations`` counts the neurons of spiking layers, ``spikes`` those that fired. An
    operation is what one input that is not zero does at one weight that is not zero: it adds (``effective_acs``) where
    all inputs of a window are spikes, and multiplies and adds (``effective_macs``) otherwise. ``dense`` counts what
    there would be without zeros.
    """

    windows: int = 0
    activations: int = 0
    spikes: int = 0
    effective_macs: int = 0
    effective_acs: int = 0
    dense: int = 0

    @property
    def activation_sparsity(self) -> float | None:
        """The share of neurons and steps without a spike; None if there are no spiking layers."""
        return (self.activations - self.spikes) / self.activations if self.activations else None

    def __add__(self, other: "Work") -> "Work":
        """Return the counts of both."""
        return Work(*map(add, astuple(self), astuple(other)))


class WorkMeter:
    """Counts what the layers of a region, and modules of the kind ``torch.nn.Linear`` in it, do while it steps.

    Recurrent synapses are given the spikes of the step before; of the first step, those that the state tells of.
    """

    def __init__(self, region: Region) -> None:
        """Look at the weights; they must stay as they are."""
        self.region = region
        self._fan_out = {module: fan_out(module) for module in connections(region)}
        self._biases = set(biases(region))
        self._work = Work()
        self._heard: dict[str, Tensor] = {}
        self._ran: set[Layer] = set()  # since the counts were last taken
        self._seen: set[Layer] = set()  # ever

    @contextmanager
    def watching(self) -> Iterator[None]:
        """Count while the block runs; the engine then runs layer by layer, with the same spikes."""
        handles = [layer.register_forward_hook(self._layer_ran, with_kwargs=True) for layer in layers(self.region)]
        handles += [
            module.register_forward_hook(self._linear_ran, with_kwargs=True)
            for module in self._fan_out
            if isinstance(module, nn.Linear)
        ]
        try:
            yield
        finally:
            for handle in handles:
                handle.remove()

    def hear(self, layer: str, spikes: Tensor) -> None:
        """Take the spikes (steps, batch, neurons) of a layer; it is a probe for the region's steps.

        It tells of layers that run apart from the engine, as those that are driven by more than their projections do.
        """
        self._heard[layer] = spikes

    def take(self, windows: int, inputs: Mapping[str, Tensor]) -> Work:
        """Return what was counted since the last call: that of ``windows`` with these ``inputs``."""
        known = {**inputs, **self._heard}
        for circuit in circuits(self.region):
            for name, readings in circuit.readings.items():
                layer, reads = circuit.layers[name], set[str]().union(*readings)
                if name in self._heard and layer not in self._ran and reads <= known.keys():
                    given = [torch.cat([known[read] for read in group], dim=-1) for group in readings]
                    self._layer_ran(layer, (given,), {}, (self._heard[name], None))
        work = replace(self._work, windows=windows)
        self._seen |= self._ran
        self._work, self._heard, self._ran = Work(), {}, set()
        return work

    def not_counted(self) -> list[str]:
        """Say what of the region appears in none of the counts taken so far."""
        counted = [*self._fan_out, *layers(self.region)]
        parameters = {id(parameter) for module in counted for parameter in module.parameters()}
        found = [name for name, parameter in self.region.named_parameters() if id(parameter) not in parameters]
        found += [
            f"the layer {name}, which was not seen to run"
            for name, module in self.region.named_modules()
            if isinstance(module, Layer) and module not in self._seen
        ]
        if isinstance(self.region, Plastic):
            found.append("synapses that change as it runs")
        return found if counted else ["what it computes, as it has no spiking layers"]

    def _layer_ran(
        self, layer: Layer, given: tuple[Any, ...], named: Mapping[str, Any], returned: tuple[Tensor, Tensor | None]
    ) -> None:
        arguments = {**dict(zip(("inputs", "state"), given, strict=False)), **named}
        fired, _ = returned
        self._ran.add(layer)
        self._work.activations += fired.numel()
        self._work.spikes += int(fired.count_nonzero())
        for projection, spikes in zip(layer.projections, arguments["inputs"], strict=True):
            assert isinstance(projection, Projection)
            if projection not in self._biases:
                self._count(projection, spikes)
        if layer.recurrent is not None:
            first = _fired_last(layer, arguments.get("state"), fired[0])
            self._count(layer.recurrent, torch.cat([first.unsqueeze(0), fired[:-1]]))

    def _linear_ran(
        self, module: nn.Linear, given: tuple[Tensor, ...], named: Mapping[str, Tensor], returned: Tensor
    ) -> None:
        self._count(module, *given, *named.values())

    def _count(self, module: Connections, values: Tensor) -> None:
        targets_of, targets = self._fan_out[module]
        nonzero = values != 0
        effective = int(nonzero.reshape(-1, values.shape[-1]).sum(0, dtype=torch.float64) @ targets_of)
        if bool((values.abs()[nonzero] == 1).all()):
            self._work.effective_acs += effective
        else:
            self._work.effective_macs += effective
        self._work.dense += values.numel() * targets


def _fired_last(layer: Layer, state: Tensor | None, like: Tensor) -> Tensor:
    """Return the spikes (batch, neurons) of the step before a window."""
    return torch.zeros_like(like) if state is None else layer.fired(state).to(like)
