"""Windows that are prepared to run again: for inference, where much of the time would go into Python.

A window of one brain takes some tens of microseconds. To look at all arguments and to fill in the structures for the
native call would take as long again, and give the same each time. Several layers run in one call, which hands on spikes
as bits; spikes that nobody asks for are never written.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import torch
from torch import Tensor, nn

from neurorobo.engine import structures
from neurorobo.engine.checked import Seen
from neurorobo.engine.events import is_native, most_events, number_tensor
from neurorobo.engine.fired import Fired
from neurorobo.engine.kernels import TOO_DENSE, Drive, Events, Kernels, Packed, empty_words, window_arguments
from neurorobo.engine.models import carried, sends_numbers
from neurorobo.neurons import LIF, Neuron
from neurorobo.synapses import Dense, FanIn, Projection

if TYPE_CHECKING:
    from neurorobo.engine.layer import Layer

MOST_WORDS = 2**22
"""How many words of bits are kept for a window; a larger one would keep memory and gain nothing."""

PAUSE = 16
"""How many windows are not tried after one whose neurons fired so often that a matrix product is faster."""


class Stage(NamedTuple):
    """A layer, and what each of its projections reads side by side: the inputs are counted first, then the stages."""

    layer: "Layer"
    reads: Sequence[tuple[int, ...]]


class _Held(NamedTuple):
    """A parameter of a module by its name, or the index of a fan-in, and what it was when the window was prepared.

    None if there was none.
    """

    module: nn.Module
    name: str
    seen: Seen | None


class _Parts(NamedTuple):
    """What a layer is made of."""

    layer: "Layer"
    neuron: Neuron
    projections: Sequence[nn.Module]
    recurrent: nn.Module | None

    def are_still(self) -> bool:
        """Return whether the layer is made of these."""
        modules = self.layer._modules
        projections = modules["projections"]
        return (
            self.layer.neuron is self.neuron
            and projections is not None
            and list(projections._modules.values()) == self.projections
            and modules.get("recurrent") is self.recurrent
        )


class PreparedCircuit:
    """Layers, with the weights of one moment, and windows of one size; for one thread at a time."""

    def __init__(
        self,
        native: Kernels,
        window: tuple[int, int],
        sizes: Sequence[int],
        parts: Sequence[_Parts],
        held: Sequence[_Held],
        circuit: structures.Circuit,
        words: Sequence[Tensor],
        memory: Sequence[object],
    ) -> None:
        steps, batch = window
        self._native, self._parts, self._held, self._circuit, self._memory = native, parts, held, circuit, memory
        self._words = words
        self._input_shapes = [(steps, batch, size) for size in sizes]
        self._inputs = [circuit.input[number] for number in range(circuit.inputs)]
        self._stages = [circuit.stage[number] for number in range(circuit.stages)]
        self._windows = [stage.window for stage in self._stages]
        self._shapes = [(steps, batch, window.neurons) for window in self._windows]
        self._lasts = [torch.empty(batch, _carried_by(part.layer), dtype=torch.float32, device="cpu") for part in parts]
        self._pause = 0

    def fits(self, native: Kernels, inputs: Sequence[Tensor], states: Sequence[Tensor | None]) -> bool:
        """Return whether these inputs and states can be run, and everything else is as it was."""
        if native is not self._native or not is_native(*inputs, *states):
            return False
        if [spikes.shape for spikes in inputs] != self._input_shapes:
            return False
        for last, state in zip(self._lasts, states, strict=True):
            if state is not None and state.shape != last.shape:
                return False
        for parts in self._parts:
            if not parts.are_still():
                return False
        for module, name, seen in self._held:
            parameter = module._buffers["source_index"] if name == "source_index" else module._parameters.get(name)
            if parameter is None or seen is None:
                if parameter is not None or seen is not None:
                    return False
            elif not seen.is_still(parameter):
                return False
        return True

    def fired(self, number: int) -> Fired:
        """Return what a layer fired in the window that was run last; it is overwritten by the next."""
        steps, _, neurons = self._shapes[number]
        return Fired(self._native, self._words[number], steps, neurons)

    def run(
        self,
        inputs: Sequence[Tensor],
        states: Sequence[Tensor | None],
        wanted: Sequence[bool],
        carried: Sequence[bool],
    ) -> tuple[list[Tensor | None], list[Tensor | None]] | None:
        """Return the spikes of the layers that are ``wanted`` and the last potentials of those that are ``carried``.

        None if it cannot be run so, as :meth:`Kernels.run_circuit` says. Without a state a layer starts at rest.
        """
        if self._pause:
            self._pause -= 1
            return None
        native = self._native
        for given, spikes in zip(self._inputs, inputs, strict=True):
            step_stride, batch_stride, stride = spikes.stride()
            if stride != 1 and spikes.shape[2] > 1:
                return None
            given.spikes, given.step_stride, given.batch_stride = spikes.data_ptr(), step_stride, batch_stride
        fired: list[Tensor | None] = []
        lasts: list[Tensor | None] = []
        for number, (stage, window, state) in enumerate(zip(self._stages, self._windows, states, strict=True)):
            spikes_of: Tensor | None = None
            if wanted[number]:
                spikes_of = native.empty(self._shapes[number])
                window.spikes = spikes_of.data_ptr()
            else:
                window.spikes = None
            fired.append(spikes_of)
            last = self._lasts[number]
            if carried[number]:
                last = torch.empty_like(last)
            lasts.append(last if carried[number] else None)
            if state is not None:
                last.copy_(state)
            stage.from_rest = state is None
            window.last = last.data_ptr()
        failed = native.run_circuit(self._circuit)
        if failed == TOO_DENSE:
            self._pause = PAUSE
        return None if failed else (fired, lasts)


def prepare(
    native: Kernels, stages: Sequence[Stage], inputs: Sequence[Tensor], states: Sequence[Tensor | None]
) -> PreparedCircuit | None:
    """Prepare a window for inputs (steps, batch, sources) of equal steps and batch.

    None if there are neurons or projections of other kinds than the core's, if a tensor is not float32 on the CPU, if
    a parameter's changes are not counted, if sizes do not fit, or if the window is large. Raises a ValueError if a
    parameter is not finite.
    """
    if not is_native(*inputs, *states):
        return None
    steps, batch, _ = inputs[0].shape
    rows = steps * batch
    layers = [stage.layer for stage in stages]
    sizes = [spikes.shape[2] for spikes in inputs] + [layer.neurons for layer in layers]
    if rows * sum(size // 64 + 1 for size in sizes) > MOST_WORDS:
        return None
    for layer, state in zip(layers, states, strict=True):
        if not layer.is_on_native_path or sends_numbers(layer.neuron):
            return None
        if state is not None and state.shape != (batch, _carried_by(layer)):
            return None
    words = [empty_words(steps, batch, size) for size in sizes[: len(inputs)]]
    words += [empty_words(steps + 1, batch, size) for size in sizes[len(inputs) :]]
    populations = [
        structures.Population(size, there.data_ptr() + (8 * batch * there.shape[2] if len(there) > steps else 0))
        for size, there in zip(sizes, words, strict=True)
    ]
    joined: dict[tuple[int, ...], Tensor] = {}
    memory: list[object] = [words, joined]
    fired = [there[1:] for there in words[len(inputs) :]]
    parts: list[_Parts] = []
    held: list[_Held] = []
    ready: list[structures.Stage] = []
    for number, stage in enumerate(stages):
        neuron, projections = stage.layer.neuron, list(stage.layer.projections)
        recurrent = stage.layer._modules.get("recurrent")
        weights = _weights(native, stage.layer, projections, recurrent, held)
        if weights is None or len(projections) != len(stage.reads):
            return None
        parts.append(_Parts(stage.layer, neuron, projections, recurrent))
        readings: list[structures.Reading] = []
        drives: list[Drive] = []
        for projection, packed, reads in zip(projections, weights.projections, stage.reads, strict=True):
            sources = sum(sizes[read] for read in reads)
            if sources != projection.sources:
                return None
            index = projection.source_index.contiguous() if type(projection) is FanIn else None
            pieces = [populations[read] for read in reads]
            if len(reads) == 1:
                there, pieces = words[reads[0]], []
                if len(there) > steps:
                    there = there[1:]
            elif reads in joined:
                there, pieces = joined[reads], []
            else:
                there = joined[reads] = empty_words(steps, batch, sources)
            most = rows * sources if index is not None else int(most_events(rows, sources))
            readings.append(
                structures.Reading(len(pieces), (structures.Population * len(pieces))(*pieces), most),
            )
            drives.append(Drive(Events(there, sources, 0), packed, index))
        threshold = weights.threshold
        if threshold is None and isinstance(neuron, LIF):
            threshold = number_tensor(neuron.threshold)
        shape = (steps, batch, stage.layer.neurons)
        window = window_arguments(shape, drives, weights.recurrent, neuron, threshold)
        window.fired = words[len(inputs) + number].data_ptr()
        ready.append(structures.Stage(window, (structures.Reading * len(readings))(*readings)))
        memory += [drives, weights.recurrent, threshold]
    given = [structures.Input(to=population) for population in populations[: len(inputs)]]
    circuit = structures.Circuit(
        len(given), (structures.Input * len(given))(*given), len(ready), (structures.Stage * len(ready))(*ready)
    )
    return PreparedCircuit(native, (steps, batch), sizes[: len(inputs)], parts, held, circuit, fired, memory)


def _carried_by(layer: "Layer") -> int:
    return carried(layer.neuron, layer.neurons, recurrent=layer._modules.get("recurrent") is not None)


class _Weights(NamedTuple):
    """A layer's parameters as the kernels want them."""

    projections: Sequence[Packed]
    recurrent: Packed | None
    threshold: Tensor | None


def _weights(
    native: Kernels,
    layer: "Layer",
    projections: Sequence[nn.Module],
    recurrent: nn.Module | None,
    held: list[_Held],
) -> _Weights | None:
    """Return a layer's parameters and add to ``held`` what they were; None if there are others than the core's."""
    checked = layer.checked
    members: dict[str, nn.Module] = {f"projection {number}": module for number, module in enumerate(projections)}
    if recurrent is not None:
        members["recurrent"] = recurrent
    if layer._parameters.get("threshold") is None:
        if layer.threshold is not None:  # something computes it, such as a parametrization
            return None
        held.append(_Held(layer, "threshold", None))
    else:
        members["threshold"] = layer
    ready: dict[str, Packed] = {}
    for name, module in members.items():
        key = "threshold" if module is layer else "weight"
        parameter = module._parameters.get(key)
        if parameter is None or not is_native(parameter):
            return None
        if isinstance(module, Projection) and module.graded:
            return None
        if type(module) is Dense:
            ready[name] = checked.packed(name, parameter, native, narrow=True)
        elif module is layer or type(module) is FanIn:
            checked.check(name, parameter)
            ready[name] = Packed(parameter.detach().contiguous())
        else:
            return None
        seen = checked.seen(name)
        if seen is None or not seen.is_still(parameter):
            return None
        held.append(_Held(module, key, seen))
        if type(module) is FanIn:
            seen = checked.seen(f"{name}: source_index")
            if seen is None or not seen.is_still(module.source_index):
                return None
            held.append(_Held(module, "source_index", seen))
    own = ready.pop("recurrent", None)
    threshold = ready.pop("threshold", None)
    return _Weights(list(ready.values()), own, None if threshold is None else threshold.memory)


class Prepared:
    """Room for a prepared window, which one thread at a time takes out; neither saved nor copied."""

    def __init__(self) -> None:
        self._circuit: list[PreparedCircuit] = []

    def __reduce__(self) -> tuple[Any, ...]:
        return Prepared, ()

    def take(self) -> PreparedCircuit | None:
        """Take the window out, if there is one and no other thread has it."""
        try:
            return self._circuit.pop()
        except IndexError:
            return None

    def put(self, circuit: PreparedCircuit) -> None:
        """Put a window in; of those of several threads one is enough."""
        if not self._circuit:
            self._circuit.append(circuit)
