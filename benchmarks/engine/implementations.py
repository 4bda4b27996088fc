"""One network in each library, in the fastest way that the library has on a CPU.

Each is a module that turns the spikes (steps, batch, neurons) of each input into the output's, from rest. All have the
arctan surrogate and a reset through which no gradient flows, which is what snnTorch trains fastest with; but Norse has
no arctan and keeps its default, and Norse and Sinabs rectify behind the spike, which leaves the spikes as they are but
not the gradients of potentials below zero. Thresholds are not trained. Of the peers, snnTorch is compiled as well; to
compile SpikingJelly's neurons takes two minutes for a network of five layers and gains about a quarter.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Any
from unittest import mock

import torch
from networks import Network, Population
from torch import Tensor, nn

from neurorobo.engine import Circuit, Layer
from neurorobo.engine.circuit import Reads
from neurorobo.neurons import LIF, Surrogate
from neurorobo.synapses import Dense, FanIn


class Implementation(nn.Module):
    """A network in some library."""

    library = ""
    compiled = False
    is_native = False
    workloads: tuple[str, ...] = ("b1", "b256", "train")

    def __init__(self, network: Network) -> None:
        super().__init__()
        self.populations = network.populations

    def around(self) -> AbstractContextManager[object]:
        """Return what the module is to be run in."""
        return nullcontext()

    def inputs(self, known: Sequence[Tensor], population: Population) -> Tensor:
        """Return what a population reads, side by side."""
        first, *rest = (known[read] for read in population.reads)
        return torch.cat([first, *rest], dim=-1) if rest else first


class Native(Implementation):
    """neurorobo's layers, with a projection for each population that a layer reads."""

    library = "neurorobo"
    is_native = True

    def __init__(self, network: Network) -> None:
        super().__init__(network)
        generator = torch.Generator().manual_seed(0)
        inputs = [f"input {number}" for number in range(len(network.sizes))]
        names = [*inputs, *(f"population {number}" for number in range(len(network.populations)))]
        layers: dict[str, tuple[Layer, Sequence[Reads]]] = {}
        for name, population in zip(names[len(inputs) :], network.populations, strict=True):
            neurons, sources = population.neurons, network.sources(population)
            projections: list[Dense | FanIn] = []
            if population.index is None:
                projections += [Dense(size, neurons, generator) for size in sources]
                weights = population.weight.split(sources, dim=1)
            else:
                fan_in = FanIn(sum(sources), neurons, population.index.shape[1], generator)
                fan_in.source_index.copy_(population.index)
                projections, weights = [fan_in], (population.weight,)
            for projection, weight in zip(projections, weights, strict=True):
                projection.weight.data.copy_(weight)
            own = None
            if population.recurrent is not None:
                own = Dense(neurons, neurons, generator)
                own.weight.data.copy_(population.recurrent)
            several = isinstance(population.threshold, Tensor)
            neuron = LIF(
                0.5 if several else float(population.threshold),
                population.decay,
                Surrogate("arctan", 2 / math.pi),
                "detached",
                population.rectify,
            )
            layer = Layer(projections, neuron, own, trainable_threshold=several)
            if layer.threshold is not None:
                layer.threshold.requires_grad_(False).copy_(torch.as_tensor(population.threshold))
            read = [names[number] for number in population.reads]
            layers[name] = (layer, read if population.index is None else [read])
        self.layers = nn.ModuleList(layer for layer, _ in layers.values())
        self.circuit = Circuit(inputs, layers)
        self.output = names[-1:]

    def forward(self, inputs: Sequence[Tensor]) -> Tensor:
        """Run one window."""
        spikes, _ = self.circuit(dict(zip(self.circuit.inputs, inputs, strict=True)), wanted=self.output)
        return spikes[self.output[0]]


class NativeBf16(Native):
    """The same as a phase with `precision: bf16` trains it: matrix products round their factors, spikes are exact."""

    workloads = ("train",)

    @contextmanager
    def around(self) -> Iterator[None]:
        """Switch to what :func:`neurorobo.learning.supervise.supervise` switches to."""
        matmul = torch.backends.mkldnn.matmul  # type: ignore[attr-defined] # torch's stubs lag behind
        before = matmul.fp32_precision
        matmul.fp32_precision = "bf16"
        try:
            yield
        finally:
            matmul.fp32_precision = before


class NativeFloats(Native):
    """The same as if the weights lay on no grid: they are not packed in fewer bits."""

    workloads = ("b1", "b256")

    def around(self) -> AbstractContextManager[object]:
        """Keep the kernels from finding a grid."""
        return mock.patch("neurorobo.engine.kernels._grid", lambda weight: None)


class Portable(Native):
    """The same without the native library."""

    is_native = False

    def around(self) -> AbstractContextManager[object]:
        """Keep the engine from its library."""
        return mock.patch("neurorobo.engine.kernels.library", lambda: None)


class Peer(Implementation):
    """A library's neurons between linear layers of torch, one for all that a population reads.

    Layer by layer: the currents of all steps come from one product, and the neurons are stepped, if the library does
    not do that itself. Weights are divided by what `gain` says the library multiplies its currents with.
    """

    def __init__(self, network: Network) -> None:
        super().__init__(network)
        self.linear = nn.ModuleList(
            self._linear(population, population.matrix(sum(network.sources(population))))
            for population in network.populations
        )
        self.recurrent = nn.ModuleList(
            nn.Identity() if population.recurrent is None else self._linear(population, population.recurrent)
            for population in network.populations
        )
        self.neurons = nn.ModuleList(
            self.neuron(population, recurrent)
            for population, recurrent in zip(network.populations, self.recurrent, strict=True)
        )

    def neuron(self, population: Population, recurrent: nn.Module) -> nn.Module:
        """Return the library's neurons."""
        raise NotImplementedError

    def gain(self, population: Population) -> float:
        """Return what the library multiplies currents with."""
        return 1.0

    def window(self, population: Population, neuron: Any, current: Tensor, recurrent: nn.Module) -> Tensor:
        """Run neurons on the currents (steps, batch, neurons) of a window."""
        raise NotImplementedError

    def forward(self, inputs: Sequence[Tensor]) -> Tensor:
        """Run one window."""
        known = list(inputs)
        for population, linear, neuron, recurrent in self.layers():
            known.append(self.window(population, neuron, linear(self.inputs(known, population)), recurrent))
        return known[-1]

    def layers(self) -> Iterator[tuple[Population, nn.Module, nn.Module, nn.Module]]:
        """Iterate over populations, their linear layers, neurons and recurrent layers."""
        return zip(self.populations, self.linear, self.neurons, self.recurrent, strict=True)

    def _linear(self, population: Population, weight: Tensor) -> nn.Linear:
        neurons, sources = weight.shape
        linear = nn.Linear(sources, neurons, bias=False)
        linear.weight.data.copy_(weight / self.gain(population))
        return linear


class SnnTorch(Peer):
    """snnTorch's Leaky; its recurrent neuron would evaluate the recurrent product twice."""

    library = "snntorch"

    def neuron(self, population: Population, recurrent: nn.Module) -> nn.Module:
        """Return neurons that fire above the number next to the threshold, hence at the threshold."""
        import snntorch
        from snntorch import surrogate

        return snntorch.Leaky(  # type: ignore[no-any-return]
            beta=population.decay,
            threshold=_below(population.threshold, 0.0),
            spike_grad=surrogate.atan(alpha=2.0),
            reset_mechanism="zero",
            reset_delay=True,
            state_quant=torch.relu if population.rectify else False,
        )

    def window(self, population: Population, neuron: Any, current: Tensor, recurrent: nn.Module) -> Tensor:
        """Step the neurons."""
        return self._steps(neuron, current, recurrent, torch.zeros_like(current[0]), torch.zeros_like(current[0]))[0]

    @staticmethod
    def _steps(
        neuron: Any, current: Tensor, recurrent: nn.Module, fired: Tensor, potential: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        rows = []
        for now in current:
            if isinstance(recurrent, nn.Linear):
                now = now + recurrent(fired)
            fired, potential = neuron(now, potential)
            rows.append(fired)
        return torch.stack(rows), fired, potential


class SnnTorchCompiled(SnnTorch):
    """The same compiled, ten steps at once: to compile whole windows takes minutes for each layer."""

    compiled = True
    steps_at_once = 10

    def __init__(self, network: Network) -> None:
        super().__init__(network)
        self._compiled = _compile(self._steps)

    def window(self, population: Population, neuron: Any, current: Tensor, recurrent: nn.Module) -> Tensor:
        """Step the neurons."""
        fired = potential = torch.zeros_like(current[0])
        pieces = []
        for piece in current.split(self.steps_at_once):
            spikes, fired, potential = self._compiled(neuron, piece, recurrent, fired, potential)
            pieces.append(spikes)
        return torch.cat(pieces)


class SnnTorchStepwise(SnnTorch):
    """snnTorch step by step, as its tutorials have it: all layers in one step, then the next."""

    def forward(self, inputs: Sequence[Tensor]) -> Tensor:
        """Run one window."""
        batch = inputs[0].shape[1]
        fired = [inputs[0].new_zeros(batch, population.neurons) for population in self.populations]
        potentials, rows = fired, []
        for now in zip(*inputs, strict=True):
            fired, potentials = self.step(list(now), fired, potentials)
            rows.append(fired[-1])
        return torch.stack(rows)

    def step(
        self, now: list[Tensor], fired: list[Tensor], potentials: list[Tensor]
    ) -> tuple[list[Tensor], list[Tensor]]:
        """Run all layers for one step."""
        known, after = list(now), []
        for (population, linear, neuron, recurrent), last, potential in zip(
            self.layers(), fired, potentials, strict=True
        ):
            current = linear(self.inputs(known, population))
            if isinstance(recurrent, nn.Linear):
                current = current + recurrent(last)
            spikes, potential = neuron(current, potential)
            known.append(spikes)
            after.append(potential)
        return known[len(now) :], after


class SnnTorchStepwiseCompiled(SnnTorchStepwise):
    """The same with the step compiled."""

    compiled = True

    def __init__(self, network: Network) -> None:
        super().__init__(network)
        self.step = _compile(self.step)  # type: ignore[method-assign]


class SpikingJelly(Peer):
    """SpikingJelly's multi-step layers; a recurrent population in a loop of its single steps."""

    library = "spikingjelly"

    def neuron(self, population: Population, recurrent: nn.Module) -> nn.Module:
        """Return its LIF, or one derived from it as its manual has it for neurons of one's own."""
        from spikingjelly.activation_based import neuron, surrogate

        class SpikingNeuralUnit(neuron.SimpleLIFNode):  # type: ignore[misc]
            def neuronal_charge(self, x: Tensor) -> None:
                super().neuronal_charge(x)
                self.v: Tensor = self.v.relu()

        own_equation = population.rectify or isinstance(population.threshold, Tensor)
        return (SpikingNeuralUnit if own_equation else neuron.LIFNode)(
            tau=1 / (1 - population.decay),
            decay_input=False,
            v_threshold=population.threshold,
            v_reset=0.0,
            surrogate_function=surrogate.ATan(alpha=2.0),
            detach_reset=True,
            step_mode="m" if population.recurrent is None else "s",
        )

    def window(self, population: Population, neuron: Any, current: Tensor, recurrent: nn.Module) -> Tensor:
        """Run the neurons."""
        neuron.reset()
        if population.recurrent is None:
            return neuron(current)  # type: ignore[no-any-return]
        fired, rows = torch.zeros_like(current[0]), []
        for now in current:
            fired = neuron(now + recurrent(fired))
            rows.append(fired)
        return torch.stack(rows)


class Norse(Peer):
    """Norse's LIFBoxCell, whose equation multiplies currents with 1 - decay."""

    library = "norse"

    def gain(self, population: Population) -> float:
        """Return what it multiplies currents with."""
        return 1 - population.decay

    def neuron(self, population: Population, recurrent: nn.Module) -> nn.Module:
        """Return neurons that fire a little below the threshold, as its rounding would miss the threshold itself."""
        from norse.torch import LIFBoxCell, LIFBoxParameters

        parameters = LIFBoxParameters(
            tau_mem_inv=torch.tensor((1 - population.decay) / 1e-3),
            v_th=_below(population.threshold, 2.0**-22),
            reset_method=lambda fired, potential, reset, threshold: potential * (1 - fired.detach()),
        )
        return LIFBoxCell(parameters, dt=1e-3)  # type: ignore[no-any-return]

    def window(self, population: Population, neuron: Any, current: Tensor, recurrent: nn.Module) -> Tensor:
        """Step the neurons."""
        from norse.torch.functional.lif_box import LIFBoxFeedForwardState

        fired, rows = torch.zeros_like(current[0]), []
        state = LIFBoxFeedForwardState(v=fired)
        for now in current:
            if population.recurrent is not None:
                now = now + recurrent(fired)
            fired, state = neuron(now, state)
            if population.rectify:
                state = LIFBoxFeedForwardState(v=state.v.relu())
            rows.append(fired)
        return torch.stack(rows)


class Sinabs(Peer):
    """Sinabs' layers over (batch, steps, neurons)."""

    library = "sinabs"

    def neuron(self, population: Population, recurrent: nn.Module) -> nn.Module:
        """Return its LIF, whose least potential serves to rectify, with the decay as a number that is not trained."""
        from sinabs.activation import MembraneReset, SingleSpike
        from sinabs.layers import LIF, LIFRecurrent

        settings = {
            "tau_mem": -1 / math.log(population.decay),
            "spike_threshold": torch.as_tensor(population.threshold),
            "spike_fn": SingleSpike,
            "reset_fn": MembraneReset(),
            "surrogate_grad_fn": _arctan,
            "min_v_mem": 0.0 if population.rectify else None,
            "train_alphas": True,
            "norm_input": False,
        }
        layer = LIF(**settings) if population.recurrent is None else LIFRecurrent(rec_connect=recurrent, **settings)
        layer.alpha_mem.requires_grad_(False).fill_(population.decay)
        return layer  # type: ignore[no-any-return]

    def window(self, population: Population, neuron: Any, current: Tensor, recurrent: nn.Module) -> Tensor:
        """Run the neurons from rest, which must be told when the batch changes."""
        batch, neurons = current.shape[1:]
        if neuron.state_has_shape((batch, neurons)):
            neuron.reset_states()
        else:
            neuron.init_state_with_shape((batch, neurons))
        return neuron(current.transpose(0, 1)).transpose(0, 1)  # type: ignore[no-any-return]


def _compile(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return what torch.compile makes of a function, anew for each layer; an error if it cannot make one graph."""
    torch._dynamo.config.recompile_limit = 64
    return torch.compile(function, fullgraph=True)


def _below(threshold: float | Tensor, share: float) -> Tensor:
    """Return the next number below a threshold, less a share of it, for who fires only above its threshold."""
    exact = torch.as_tensor(threshold, dtype=torch.float32)
    return torch.nextafter(exact * (1 - share), torch.zeros(()))


def _arctan(potential: Tensor, threshold: Tensor) -> Tensor:
    return 1 / (1 + (math.pi * (potential - threshold)).square())


IMPLEMENTATIONS: dict[str, type[Implementation]] = {
    "neurorobo, native": Native,
    "neurorobo, native, bf16": NativeBf16,
    "neurorobo, native, floats": NativeFloats,
    "neurorobo, portable": Portable,
    "snnTorch": SnnTorch,
    "snnTorch, compiled": SnnTorchCompiled,
    "snnTorch, stepwise": SnnTorchStepwise,
    "snnTorch, stepwise, compiled": SnnTorchStepwiseCompiled,
    "SpikingJelly": SpikingJelly,
    "Norse": Norse,
    "Sinabs": Sinabs,
}
