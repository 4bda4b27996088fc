"""A layer's window, prepared to run again: for inference in small batches, where most of the time goes into Python.

A window of one brain takes some tens of microseconds. To look at all arguments and to fill in the structure for the
native call would take as long again, and give the same each time.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from neurorobo.engine.checked import CheckedWeights, Seen
from neurorobo.engine.events import is_native, most_events, number_tensor
from neurorobo.engine.kernels import Drive, Events, Kernels, NativeWindow, Packed
from neurorobo.neurons import LIF
from neurorobo.synapses import Dense, FanIn, Projection

MOST_ROWS = 4096
"""Steps x batch elements of the largest window that is prepared; a larger one would keep memory and gain nothing."""


class Held(NamedTuple):
    """A parameter of a module by its name, or the index of a fan-in, and what it was when the window was prepared.

    None if there was none.
    """

    module: nn.Module
    name: str
    seen: Seen | None


class PreparedWindow:
    """A window of one shape (steps, batch, neurons) with the weights of one moment; for one thread at a time.

    ``held`` are the parameters that it depends on, ``drives`` and ``projections`` one for each input.
    """

    def __init__(
        self,
        native: Kernels,
        shape: Sequence[int],
        projections: Sequence[Projection],
        drives: Sequence[Drive],
        recurrent: nn.Module | None,
        recurrent_weights: Packed | None,
        neuron: LIF,
        threshold: Tensor,
        held: Sequence[Held],
    ) -> None:
        steps, batch, neurons = shape
        self._native, self._neuron, self._held = native, neuron, held
        self._projections, self._recurrent = list(projections), recurrent
        self._shape = tuple(shape)
        self._state_shape = (batch, neurons)
        self._input_shapes = [(steps, batch, drive.events.sources) for drive in drives]
        self._words = [drive.events.words for drive in drives]
        self._most = [
            math.inf if drive.source_index is not None else most_events(steps * batch, drive.events.sources)
            for drive in drives
        ]
        self._window = NativeWindow(shape, drives, recurrent_weights, neuron, threshold)

    def fits(
        self,
        native: Kernels,
        neuron: LIF,
        projections: Sequence[nn.Module],
        recurrent: nn.Module | None,
        inputs: Sequence[Tensor],
        state: Tensor | None,
    ) -> bool:
        """Return whether these inputs and this state can be run, and everything else is as it was."""
        if native is not self._native or neuron is not self._neuron:
            return False
        if projections != self._projections or recurrent is not self._recurrent:
            return False
        if (state is not None and state.shape != self._state_shape) or not is_native(state, *inputs):
            return False
        if [spikes.shape for spikes in inputs] != self._input_shapes:
            return False
        for module, name, seen in self._held:
            parameter = module._buffers["source_index"] if name == "source_index" else module._parameters.get(name)
            if parameter is None or seen is None:
                if parameter is not None or seen is not None:
                    return False
            elif not seen.is_still(parameter):
                return False
        return True

    def run(self, inputs: Sequence[Tensor], state: Tensor | None) -> tuple[Tensor, Tensor] | None:
        """Return spikes and last potential; None if an input fires so often that a matrix product is faster.

        Without a state the neurons start at rest.
        """
        native, ones = self._native, 0
        for spikes, words, most in zip(inputs, self._words, self._most, strict=True):
            count = native.pack_into(words, spikes)
            if count > most:
                return None
            ones += count
        last = torch.zeros(self._state_shape, dtype=torch.float32, device="cpu")
        if state is not None:
            last.copy_(state)
        fired = native.empty(self._shape)
        native.run(self._window, ones, last, fired)
        return fired, last


def prepare(
    native: Kernels,
    checked: CheckedWeights,
    neuron: LIF,
    shape: Sequence[int],
    projections: Sequence[nn.Module],
    recurrent: nn.Module | None,
    layer: nn.Module,
) -> PreparedWindow | None:
    """Prepare a window of a layer.

    None if it has projections of other kinds than the core's, if a parameter is not float32 on the CPU, or if its
    changes are not counted. Raises a ValueError if one is not finite.
    """
    steps, batch, _ = shape
    members: dict[str, nn.Module] = {f"projection {number}": module for number, module in enumerate(projections)}
    if recurrent is not None:
        members["recurrent"] = recurrent
    held: list[Held] = []
    if layer._parameters.get("threshold") is None:
        held.append(Held(layer, "threshold", None))
    else:
        members["threshold"] = layer
    ready: dict[str, Packed] = {}
    for name, module in members.items():
        key = "threshold" if module is layer else "weight"
        parameter = module._parameters.get(key)
        if parameter is None or not is_native(parameter):
            return None
        if type(module) is Dense:
            ready[name] = checked.packed(name, parameter, native, as_bytes=True)
        elif module is layer or type(module) is FanIn:
            checked.check(name, parameter)
            ready[name] = Packed(parameter.detach().contiguous())
        else:
            return None
        seen = checked.seen(name)
        if seen is None or not seen.is_still(parameter):
            return None
        held.append(Held(module, key, seen))
        if type(module) is FanIn:
            seen = checked.seen(f"{name}: source_index")
            if seen is None or not seen.is_still(module.source_index):
                return None
            held.append(Held(module, "source_index", seen))
    known = [module for module in projections if isinstance(module, Projection)]
    drives = []
    for module, weights in zip(known, ready.values(), strict=False):  # the projections come first
        words = torch.empty(steps, batch, (module.sources + 63) // 64, dtype=torch.int64, device="cpu")
        index = module.source_index.contiguous() if isinstance(module, FanIn) else None
        drives.append(Drive(Events(words, module.sources, 0), weights, index))
    threshold = ready["threshold"].memory if "threshold" in ready else number_tensor(neuron.threshold)
    return PreparedWindow(native, shape, known, drives, recurrent, ready.get("recurrent"), neuron, threshold, held)


class Prepared:
    """Room for a prepared window, which one thread at a time takes out; neither saved nor copied."""

    def __init__(self) -> None:
        self._window: list[PreparedWindow] = []

    def __reduce__(self) -> tuple[Any, ...]:
        return Prepared, ()

    def take(self) -> PreparedWindow | None:
        """Take the window out, if there is one and no other thread has it."""
        try:
            return self._window.pop()
        except IndexError:
            return None

    def put(self, window: PreparedWindow) -> None:
        """Put a window in; of those of several threads one is enough."""
        if not self._window:
            self._window.append(window)
