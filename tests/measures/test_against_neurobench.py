"""NeuroBench itself, on a copy of the network in plain modules of torch, finds the same figures to the last digit."""

from collections.abc import Mapping, Sequence
from typing import Any

import pytest
import snntorch
import torch
from samples import NETWORKS, circuit, network, spikes
from torch import Tensor, nn

from neurorobo.engine import Layer
from neurorobo.measures import Work, WorkMeter, size_of
from neurorobo.neurons import LIF
from neurorobo.regions.region import Region
from neurorobo.regions.spiking_network import ALWAYS
from neurorobo.synapses import Projection
from tests.measures.toys import Analogue
from tests.regions.toys import CLOCK, Net, NetConfig

pytest.importorskip("neurobench", reason="NeuroBench is not installed: pip install --no-deps neurobench")

from neurobench.metrics.static import ConnectionSparsity, Footprint, ParameterCount
from neurobench.metrics.workload import ActivationSparsity, SynapticOperations
from neurobench.models import NeuroBenchModel, SNNTorchModel

Wiring = Mapping[str, tuple[Layer, Sequence[Sequence[str]]]]
STEPS, BATCH = 20, 4


class Neurons(nn.Module):
    """The neurons of a layer, step by step."""

    def __init__(self, layer: Layer) -> None:
        super().__init__()
        assert isinstance(layer.neuron, LIF)
        self.neuron, self.size = layer.neuron, layer.neurons
        self.threshold = self.neuron.threshold if layer.threshold is None else layer.threshold.detach()

    def reset(self, batch: int) -> None:
        self.potential = self.fired = torch.zeros(batch, self.size)

    def forward(self, current: Tensor) -> Tensor:
        self.potential = self.neuron.decay * self.potential * (1 - self.fired) + current
        self.fired = (self.potential >= self.threshold).float()
        return self.fired


def linear(projection: Projection) -> nn.Linear:
    """The weights as a matrix, zero where there is no synapse."""
    found = nn.Linear(projection.sources, projection.targets, bias=False)
    found.weight.data = projection.matrix().detach().clone()
    return found


class Copy(nn.Module):
    """A network of spiking layers in modules that NeuroBench knows."""

    def __init__(self, wiring: Wiring) -> None:
        super().__init__()
        self.synapses, self.recurrent, self.neurons = nn.ModuleDict(), nn.ModuleDict(), nn.ModuleDict()
        self.reads: dict[str, list[Sequence[str]]] = {}
        for name, (layer, readings) in wiring.items():
            pairs = list(zip(layer.projections, readings, strict=True))
            matrices = [linear(projection) for projection, reads in pairs if reads != (ALWAYS,)]  # type: ignore[arg-type]
            for projection, reads in pairs:
                if reads == (ALWAYS,):
                    matrices[0].bias = nn.Parameter(projection.matrix().detach().flatten())  # type: ignore[operator]
            self.synapses[name] = nn.ModuleList(matrices)
            self.reads[name] = [reads for reads in readings if reads != (ALWAYS,)]
            if layer.recurrent is not None:
                self.recurrent[name] = linear(layer.recurrent)
            self.neurons[name] = Neurons(layer)

    def forward(self, known: dict[str, Tensor]) -> dict[str, Tensor]:
        """One step: the spikes of each input -> those of each layer as well."""
        for name, neurons in self.neurons.items():
            assert isinstance(neurons, Neurons)
            current = torch.zeros(len(neurons.fired), neurons.size)
            for matrix, reads in zip(self.synapses[name], self.reads[name], strict=True):  # type: ignore[arg-type]
                current = current + matrix(torch.cat([known[read] for read in reads], dim=1))
            if name in self.recurrent:
                current = current + self.recurrent[name](neurons.fired)
            known = {**known, name: neurons(current)}
        return known


class Model(NeuroBenchModel):  # type: ignore[misc]
    """NeuroBench's view of a network, or of one of our regions."""

    def __init__(self, network: nn.Module) -> None:
        super().__init__()
        self.network = network
        self.add_activation_module(Neurons)

    def __net__(self) -> nn.Module:
        return self.network

    def __call__(self, inputs: Mapping[str, Tensor]) -> None:
        """Run from rest on the spikes (steps, batch, channels) of each input."""
        some = next(iter(inputs.values()))
        for neurons in self.network.neurons.values():  # type: ignore[union-attr,operator]
            neurons.reset(some.shape[1])
        for step in range(len(some)):
            self.network({name: window[step] for name, window in inputs.items()})


def theirs(wiring: Wiring, inputs: Mapping[str, Tensor]) -> dict[str, Any]:
    """What NeuroBench says of the copy."""
    model = Model(Copy(wiring))
    model.register_hooks()
    with torch.no_grad():
        model(inputs)
        data = (torch.empty(next(iter(inputs.values())).shape[1]), None)  # it asks for the number of samples
        return {
            "connection sparsity": ConnectionSparsity()(model),
            "activation sparsity": ActivationSparsity()(model, None, data),
            **SynapticOperations()(model, None, data),
        }


def ours(region: Region, work: Work) -> dict[str, Any]:
    """What we say, rounded and per sample as there."""
    sparsity = size_of(region).connection_sparsity
    assert sparsity is not None
    return {
        "connection sparsity": round(sparsity, 4),
        "activation sparsity": work.activation_sparsity,
        "Effective_MACs": work.effective_macs / work.windows,
        "Effective_ACs": work.effective_acs / work.windows,
        "Dense": work.dense / work.windows,
    }


def measured(region: Region, windows: Sequence[Mapping[str, Tensor]]) -> Work:
    """Step a region through windows that follow one another."""
    meter, state = WorkMeter(region), region.init_state(BATCH)
    with meter.watching(), torch.inference_mode():
        for inputs in windows:
            _, state = region.step(inputs, state)
    return meter.take(BATCH, {})


@torch.no_grad()
def to_grid(region: Region) -> None:
    """Round the weights, so that sums are exact in any order, and some are zero."""
    for parameter in region.parameters():
        parameter.copy_((parameter * 8).round() / 8)


def inputs_of(region: Region, seed: int, steps: int = STEPS) -> dict[str, Tensor]:
    sizes = [port.channels for port in region.input_ports.values()]
    return dict(zip(region.input_ports, spikes(region, steps, BATCH, seed).split(sizes, dim=-1), strict=True))


def wiring_of(region: Region) -> Wiring:
    if isinstance(region, Net):  # it holds no circuit
        return {"hidden": (region.hidden, [("force",)]), "output": (region.output, [("hidden",), ("force",)])}
    found = circuit(region)
    return {name: (found.layers[name], readings) for name, readings in found.readings.items()}


def regions(name: str) -> Region:
    if name == "fan-in, signs and thresholds":
        return Net(NetConfig(), CLOCK, torch.Generator().manual_seed(1))
    return NETWORKS[name](1)


@pytest.mark.parametrize("name", [*NETWORKS, "fan-in, signs and thresholds"])
def test_neurobench_finds_the_same_figures(name: str) -> None:
    region = regions(name)
    to_grid(region)
    inputs = inputs_of(region, seed=2)
    expected = theirs(wiring_of(region), inputs)
    assert ours(region, measured(region, [inputs])) == expected
    assert 0 < expected["Effective_ACs"] < expected["Dense"]
    assert 0.01 < expected["connection sparsity"] < 0.99
    assert 0.02 < expected["activation sparsity"] < 0.98


@pytest.mark.parametrize("name", [*NETWORKS, "fan-in, signs and thresholds"])
def test_windows_that_carry_their_state_are_one_long_sample(name: str) -> None:
    """The first step of a window is given the spikes of the last one of the window before."""
    region = regions(name)
    to_grid(region)
    inputs = inputs_of(region, seed=3, steps=2 * STEPS)
    halves = [{name: window[:STEPS] for name, window in inputs.items()}, {n: w[STEPS:] for n, w in inputs.items()}]
    assert ours(region, measured(region, halves)) == theirs(wiring_of(region), inputs)


@pytest.mark.parametrize("name", [*NETWORKS, "fan-in, signs and thresholds"])
def test_neurobench_weighs_our_regions_as_they_are(name: str) -> None:
    region = regions(name)
    size = size_of(region)
    assert size.parameter_count == ParameterCount()(Model(region))
    assert size.footprint == Footprint()(Model(region))


def test_a_network_of_snntorch_costs_what_it_costs_there() -> None:
    """NeuroBench runs snnTorch's network, we run it as a region."""
    leaky = {"neuron": {"type": "snntorch_neuron", "beta": 0.9}, "bias": True}
    layers = {
        "hidden": {"neurons": 30, "reads": ["inputs"], **leaky},
        "output": {"neurons": 10, "reads": ["hidden"], **leaky},
    }
    region = network(layers, seed=1)
    to_grid(region)
    inputs = inputs_of(region, seed=2)
    weights, there = list(region.parameters()), {"beta": 0.9, "init_hidden": True}
    modules = [nn.Linear(20, 30), snntorch.Leaky(**there), nn.Linear(30, 10), snntorch.Leaky(**there, output=True)]
    for matrix, (weight, bias) in zip(modules[::2], (weights[:2], weights[2:]), strict=True):
        matrix.weight.data, matrix.bias.data = weight.detach(), bias.detach().flatten()
    model = SNNTorchModel(nn.Sequential(*modules))
    model.register_hooks()
    data = (inputs["x"].transpose(0, 1), None)
    with torch.no_grad():
        model(data[0])
        expected = {
            "connection sparsity": ConnectionSparsity()(model),
            "activation sparsity": ActivationSparsity()(model, None, data),
            **SynapticOperations()(model, None, data),
        }
    assert ours(region, measured(region, [inputs])) == expected
    assert size_of(region).parameter_count == ParameterCount()(model)
    assert 0.02 < expected["activation sparsity"] < 0.98


@pytest.mark.parametrize("spiking", [True, False])
def test_a_plain_matrix_counts_as_it_does_there(spiking: bool) -> None:
    """It adds where all that it is given is -1, 0 or 1, and multiplies otherwise."""
    region = Analogue()
    values = torch.tensor([[1.0, 0.0, -1.0], [0.0, 0.0, 1.0]])
    if not spiking:
        values = 0.5 * values
    meter = WorkMeter(region)
    with meter.watching(), torch.inference_mode():
        region.step({"x": values}, {})
    work = meter.take(2, {})
    model = Model(region)
    model.register_hooks()
    with torch.no_grad():
        region.step({"x": values}, {})
        expected = SynapticOperations()(model, None, (values, None))
    assert expected == {
        "Effective_MACs": work.effective_macs / 2,
        "Effective_ACs": work.effective_acs / 2,
        "Dense": work.dense / 2,
    }
    assert (expected["Effective_ACs"] > 0) == spiking
