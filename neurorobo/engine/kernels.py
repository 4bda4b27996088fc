"""The functions of the native library, from tensors to pointers.

All tensors are float32 on the CPU; where a shape is stated without strides, they are contiguous. Nothing here knows of
gradients. Sizes are the caller's to check.
"""

import ctypes
import math
import os
from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import numpy
import torch
from torch import Tensor

from neurorobo.engine import structures
from neurorobo.engine.models import SHAPES, native_model
from neurorobo.engine.native import library
from neurorobo.engine.structures import Integer, Pointer
from neurorobo.neurons import LIF, Neuron

LARGE_BYTES = 2**23
"""From what size on memory asks for large pages; what is smaller, the allocator hands out again as it is."""

TOO_DENSE = 5
"""What a circuit ends with if neurons fire so often that a matrix product is faster."""

WORK_FOR_THREADS = 4_000_000
"""Additions of one weight below which a window stays on one thread: they take about as long as starting another."""


class Events(NamedTuple):
    """The spikes of a population as bits: ``words`` (steps, batch, words of 64 sources), and how many there are."""

    words: Tensor
    sources: int
    ones: int


class Packed(NamedTuple):
    """Weights as the kernels want them: floats of 32 bits, or 8 or 16 ``bits`` that count multiples of a ``unit``.

    ``tried_narrow`` tells of floats that they do not fit into fewer bits.
    """

    memory: Tensor
    bits: int = 32
    unit: float = 0.0
    tried_narrow: bool = False

    def serves(self, narrow: bool) -> bool:
        """Return whether they are what packing them anew would give."""
        return self.bits < 32 or self.tried_narrow if narrow else self.bits == 32


class Drive(NamedTuple):
    """One projection onto a layer: events, and weights: packed, or (targets, fan_in) with their sources' index."""

    events: Events
    weights: Packed
    source_index: Tensor | None


def kernels() -> "Kernels | None":
    """Return the native library, or None on the portable path."""
    found = library()
    return None if found is None else _bound(found)


class Kernels:
    """The native library."""

    def __init__(self, library: ctypes.CDLL) -> None:
        self._pack_spikes = library.neurorobo_pack_spikes
        self._pack_spikes.argtypes = (Pointer, *(Integer,) * 5, Pointer)
        self._pack_weights = library.neurorobo_pack_weights
        self._pack_weights.argtypes = (Pointer, Integer, Integer, Pointer)
        self._packed_size = library.neurorobo_packed_size
        self._packed_size.argtypes = (Integer, Integer)
        self._pack_narrow = library.neurorobo_pack_narrow
        self._pack_narrow.argtypes = (Pointer, Integer, Integer, ctypes.c_double, Integer, Pointer)
        self._narrow_size = library.neurorobo_narrow_size
        self._narrow_size.argtypes = (Integer, Integer, Integer)
        self._count = library.neurorobo_count
        self._count.argtypes = (Pointer, Integer, Integer, Integer, Pointer)
        self._pick = library.neurorobo_pick
        self._pick.argtypes = (Pointer, Integer, Integer, Pointer, Integer, Pointer)
        self._run_window = library.neurorobo_run_window
        self._run_circuit = library.neurorobo_run_circuit
        self._encode = library.neurorobo_encode
        self._encode.argtypes = (Pointer, *(Integer,) * 4, *(ctypes.c_double,) * 2, *(Pointer,) * 2)
        self._decode = library.neurorobo_decode
        self._decode.argtypes = (Pointer, *(Integer,) * 6, *(ctypes.c_double,) * 2, Pointer)
        self._scan_back = library.neurorobo_scan_back
        self._model_back = library.neurorobo_model_back
        self._weight_gradient = library.neurorobo_weight_gradient
        for function in vars(self).values():
            function.restype = Integer
        self._use_large_pages = library.neurorobo_use_large_pages
        self._use_large_pages.argtypes = (Pointer, Integer)
        for function in (self._count, self._scan_back, self._model_back, self._decode, self._use_large_pages):
            function.restype = None
        if openmp := _openmp():
            library.neurorobo_use_openmp(openmp)

    def empty(self, shape: Sequence[int]) -> Tensor:
        """Return a tensor to be written; large ones, such as spikes of large batches, in large pages."""
        room = _floats(shape)
        if room.nbytes >= LARGE_BYTES:
            self._use_large_pages(room.data_ptr(), room.nbytes)
        return room

    def pack_spikes(self, spikes: Tensor) -> Events:
        """Turn spikes (steps, batch, sources), any strides, into events; a ValueError if any is neither 0 nor 1."""
        steps, batch, sources = spikes.shape
        words = empty_words(steps, batch, sources)
        step_stride, batch_stride, stride = spikes.stride()
        if stride != 1 and sources > 1:
            spikes = spikes.contiguous()
            step_stride, batch_stride, _ = spikes.stride()
        count: int = self._pack_spikes(
            spikes.data_ptr(), steps, batch, sources, step_stride, batch_stride, words.data_ptr()
        )
        if count < 0:
            step, rest = divmod(-1 - count, batch * sources)
            element, source = divmod(rest, sources)
            raise ValueError(not_a_spike(spikes[step, element, source].item(), step, element, source))
        return Events(words, sources, count)

    def count(self, words: Tensor) -> Tensor:
        """Return the number of spikes (batch) in words (steps, batch, words)."""
        steps, batch, row_words = words.shape
        counts = _floats((batch,))
        self._count(words.data_ptr(), steps, batch, row_words, counts.data_ptr())
        return counts

    def pick(self, words: Tensor, all_sources: int, sources: Tensor) -> Tensor:
        """Return, as booleans, the spikes (steps, batch, some) of some sources in words (steps, batch, words).

        A ValueError if any of their numbers (some), whole ones of 64 bits, is not below that of all sources.
        """
        steps, batch, _ = words.shape
        (some,) = sources.shape
        sources = sources.contiguous()
        picked = sources.new_empty((steps, batch, some), dtype=torch.bool)
        wrong: int = self._pick(
            words.data_ptr(), steps * batch, all_sources, sources.data_ptr(), some, picked.data_ptr()
        )
        if wrong >= 0:
            raise ValueError(f"neurons are numbered 0..{all_sources - 1}, got {sources[wrong].item()} at {wrong}")
        return picked

    def pack_weights(self, weight: Tensor, old: Packed | None = None, *, narrow: bool = False) -> Packed:
        """Pack weights (targets, sources), into ``old`` if it fits; a ValueError if any is not a finite number.

        With ``narrow``, those are packed in 8 or 16 bits that all are multiples of one power of two.
        """
        targets, sources = weight.shape
        weight = weight.contiguous()
        if narrow and (grid := _grid(weight)) is not None:
            unit, bits = grid
            room = torch.empty(self._narrow_size(targets, sources, bits), dtype=torch.int8, device="cpu")
            if not self._pack_narrow(weight.data_ptr(), targets, sources, unit, bits, room.data_ptr()):
                return Packed(room, bits, unit)
        size = self._packed_size(targets, sources)
        memory = _floats((size,)) if old is None or old.bits < 32 or len(old.memory) != size else old.memory
        broken = self._pack_weights(weight.data_ptr(), targets, sources, memory.data_ptr())
        if broken >= 0:
            raise ValueError(not_finite(weight, list(divmod(broken, sources))))
        return Packed(memory, tried_narrow=narrow)

    def run_window(
        self,
        drives: Sequence[Drive],
        current: Tensor | None,
        recurrent: Packed | None,
        neuron: Neuron,
        threshold: Tensor | None,
        last: Tensor,
        spikes: Tensor,
        potentials: Tensor | None,
        before: Tensor | None = None,
    ) -> Tensor | None:
        """Run a layer through a window, writing ``spikes`` and, if given, ``potentials`` (steps, batch, neurons).

        ``last`` is the state before and becomes that after: of LIF neurons the potential (batch, neurons), of others
        (batch, carried) as a layer has it. ``current`` (steps, batch, neurons) is what the drives add to. ``recurrent``
        is packed. ``threshold``, of LIF neurons, is one number or (neurons). Of others, ``potentials`` become all that
        they heard, and ``before`` (steps, batch, variables, neurons), if given, the state before each step. Returns, of
        a recurrent layer, the words (steps + 1, batch, words) of its spikes, those before the window first.
        """
        arguments = window_arguments(spikes.shape, drives, recurrent, neuron, threshold)
        steps, batch, neurons = spikes.shape
        work = sum(drive.events.ones for drive in drives) * neurons
        fired: Tensor | None = None
        if recurrent is not None:
            work += steps * batch * neurons * neurons // 8
            fired = empty_words(steps + 1, batch, neurons)
        arguments.fired = _address(fired)
        arguments.threads = _threads(work)
        arguments.current = _address(current)
        arguments.potentials = _address(potentials)
        arguments.spikes = spikes.data_ptr()
        arguments.last = last.data_ptr()
        arguments.before = _address(before)
        failed = self._run_window(ctypes.byref(arguments))
        if failed == 3:
            place = (~last.isfinite()).nonzero()[0].tolist()
            raise ValueError(f"a potential is a finite number, got {last[tuple(place)].item()} at {place}")
        if failed == 1:
            raise MemoryError(f"no memory for a window of {' x '.join(map(str, spikes.shape))} neurons")
        if failed:
            raise ValueError(f"a layer has at most 64 projections, not {arguments.projections}")
        return fired

    def run_circuit(self, circuit: structures.Circuit) -> int:
        """Run a circuit that is filled in; returns 0, or another number if it could not be run to its end.

        :data:`TOO_DENSE` is one; the others tell of mistakes, which each layer by itself finds out and names.
        """
        circuit.threads, circuit.least_work = torch.get_num_threads(), WORK_FOR_THREADS
        failed: int = self._run_circuit(ctypes.byref(circuit))
        return failed

    def scan_back(
        self,
        neuron: LIF,
        threshold: Tensor,
        potentials: Tensor,
        grad_spikes: Tensor,
        grad_last: Tensor | None,
        later: Tensor | None,
        grad_current: Tensor,
        grad_threshold: Tensor | None,
        *,
        rectify: bool,
    ) -> None:
        """Write ``grad_current`` (steps, batch, neurons) from the gradients of the spikes, of any strides.

        ``grad_last`` (batch, neurons) is that of the last potential; ``later`` that of the current one step after.
        What each batch element gives to the thresholds is added to ``grad_threshold`` (batch, neurons).
        """
        steps, batch, neurons = potentials.shape
        if neurons > 1 and grad_spikes.stride(2) != 1:
            grad_spikes = grad_spikes.contiguous()
        step_stride, batch_stride, _ = grad_spikes.stride()
        self._scan_back(
            ctypes.byref(
                structures.ScanBack(
                    steps,
                    batch,
                    neurons,
                    _threads(4 * potentials.numel()),
                    potentials.data_ptr(),
                    grad_spikes.data_ptr(),
                    step_stride,
                    batch_stride,
                    _address(grad_last),
                    _address(later),
                    threshold.data_ptr(),
                    int(threshold.numel() > 1),
                    neuron.decay,
                    neuron.reset_gradient == "full",
                    rectify,
                    SHAPES[neuron.surrogate.shape],
                    neuron.surrogate.width,
                    grad_current.data_ptr(),
                    _address(grad_threshold),
                )
            )
        )

    def model_back(
        self,
        neuron: Neuron,
        before: Tensor,
        current: Tensor,
        grad_spikes: Tensor,
        grad_state: Tensor,
        grad_current: Tensor,
    ) -> None:
        """Write ``grad_current`` (steps, batch, neurons) of neurons other than LIF.

        ``grad_spikes`` are of any strides. ``before`` (steps, batch, variables, neurons) and ``current`` (steps, batch,
        neurons) are what :meth:`run_window` wrote. ``grad_state`` (batch, variables x neurons) is that of the state
        after these steps and becomes that of the state before them.
        """
        steps, batch, neurons = current.shape
        if neurons > 1 and grad_spikes.stride(2) != 1:
            grad_spikes = grad_spikes.contiguous()
        step_stride, batch_stride, _ = grad_spikes.stride()
        model = native_model(neuron)
        assert model is not None
        self._model_back(
            ctypes.byref(
                structures.ModelBack(
                    steps,
                    batch,
                    neurons,
                    _threads(16 * current.numel()),
                    ctypes.pointer(model),
                    before.data_ptr(),
                    current.data_ptr(),
                    grad_spikes.data_ptr(),
                    step_stride,
                    batch_stride,
                    grad_state.data_ptr(),
                    grad_current.data_ptr(),
                )
            )
        )

    def weight_gradient(self, events: Events, grad_current: Tensor, index: Tensor | None) -> Tensor:
        """Return the gradient of weights (targets, sources), or (targets, fan_in) of those that ``index`` names."""
        steps, batch, targets = grad_current.shape
        fan_in = events.sources if index is None else index.shape[1]
        gradient = _floats((targets, fan_in))
        failed = self._weight_gradient(
            ctypes.byref(
                structures.WeightGradient(
                    steps * batch,
                    events.sources,
                    targets,
                    _threads(events.ones * targets if index is None else grad_current.numel() * fan_in),
                    events.words.data_ptr(),
                    grad_current.data_ptr(),
                    _address(index),
                    fan_in,
                    gradient.data_ptr(),
                )
            )
        )
        if failed:
            raise MemoryError(f"no memory for the gradient of {targets} x {events.sources} weights")
        return gradient

    def encode(
        self, values: Tensor, lo: float, hi: float, firsts: Tensor | None, spikes: Tensor, neurons: int, after: int = 0
    ) -> bool:
        """Write the spikes (steps, batch, width, channels) of values (batch, width); False if one is not finite.

        Of its channels, each value has the ``neurons`` ``after`` so many. Their spikes are as many as the value's place
        in ``lo..hi`` tells, spread evenly, or nested if ``firsts`` says of each (steps, 1, 1, neurons) from which
        number on it is there.
        """
        steps, batch, width, channels = spikes.shape
        values = values.contiguous()
        wrong: int = self._encode(
            values.data_ptr(),
            batch * width,
            neurons,
            channels,
            steps,
            lo,
            hi,
            _address(firsts),
            spikes.data_ptr() + 4 * after,
        )
        return wrong < 0

    def decode(self, spikes: Tensor, neurons: int, lo: float, resolution: float) -> Tensor:
        """Return ``lo + resolution * count`` (batch, width) of spikes (steps, batch, width * neurons)."""
        steps, batch, channels = spikes.shape
        step_stride, batch_stride, stride = spikes.stride()
        if stride != 1 and channels > 1:
            spikes = spikes.contiguous()
            step_stride, batch_stride, _ = spikes.stride()
        width = channels // neurons
        values = _floats((batch, width))
        self._decode(
            spikes.data_ptr(),
            steps,
            batch,
            width,
            neurons,
            step_stride,
            batch_stride,
            lo,
            resolution,
            values.data_ptr(),
        )
        return values


_FLOAT = torch.empty(0, dtype=torch.float32, device="cpu")


def _floats(shape: Sequence[int]) -> Tensor:
    """Return a tensor to be written, whatever the type and the device that torch takes by default."""
    return _FLOAT.new_empty(shape)  # in three quarters of the time that it takes to name both


def window_arguments(
    shape: Sequence[int],
    drives: Sequence[Drive],
    recurrent: Packed | None,
    neuron: Neuron,
    threshold: Tensor | None,
) -> structures.Window:
    """Return what the kernels need to know of a layer's window (steps, batch, neurons), but for what it writes.

    They point into the memory of the tensors, which is the caller's to keep.
    """
    steps, batch, neurons = shape
    projections = (structures.Projection * len(drives))(
        *(
            structures.Projection(
                structures.Population(drive.events.sources, drive.events.words.data_ptr()),
                _weights(drive.weights),
                _address(drive.source_index),
                0 if drive.source_index is None else drive.source_index.shape[1],
            )
            for drive in drives
        )
    )
    window = structures.Window(
        steps=steps,
        batch=batch,
        neurons=neurons,
        projections=len(drives),
        projection=projections,
        recurrent=structures.Weights() if recurrent is None else _weights(recurrent),
    )
    if isinstance(neuron, LIF):
        assert threshold is not None
        window.threshold, window.threshold_stride = threshold.data_ptr(), int(threshold.numel() > 1)
        window.decay, window.rectify = neuron.decay, neuron.rectify
    else:
        model = native_model(neuron)
        assert model is not None
        window.model = ctypes.pointer(model)
    return window


def _weights(packed: Packed) -> structures.Weights:
    return structures.Weights(packed.memory.data_ptr(), packed.unit, packed.bits)


def empty_words(steps: int, batch: int, sources: int) -> Tensor:
    """Return room for the words (steps, batch, words) of so many sources."""
    return torch.empty(steps, batch, (sources + 63) // 64, dtype=torch.int64, device="cpu")


def _grid(weight: Tensor) -> tuple[float, int] | None:
    """Return the largest power of two that all weights are multiples of, and whether 8 or 16 bits count them.

    None if they do not, or if sums of the weights onto one target might not be exact.
    """
    if weight.numel() == 0:
        return None
    weight = weight.detach()
    largest = max(abs(extreme.item()) for extreme in weight.aminmax())
    if not math.isfinite(largest) or largest == 0:
        return None
    fraction, exponent = math.frexp(largest / 32767)
    unit = math.ldexp(1.0, exponent - (fraction == 0.5))
    multiples = weight / unit
    whole = multiples.int()
    if not torch.equal(whole.float(), multiples):
        return None
    together = int(numpy.bitwise_or.reduce(whole.numpy(), axis=None))
    unit *= together & -together
    if weight.abs().sum(1, dtype=torch.float64).max() >= 2**24 * unit:
        return None
    return unit, 8 if largest <= 127 * unit else 16


def not_a_spike(value: float, step: int, element: int, source: int) -> str:
    """Say which value is no spike."""
    return f"spikes are 0 or 1, got {value:g} from source {source} (step {step}, batch element {element})"


def not_finite(weight: Tensor, place: list[int]) -> str:
    """Say which of the weights is not finite."""
    return f"weights are finite numbers, got {weight[tuple(place)].item()} at {place}"


_bound = cache(Kernels)

_PROCESS = os.getpid()
"""Where this was imported; threads that torch has started since are missing in what is forked off."""


def _openmp() -> ctypes.c_void_p | None:
    """Return the entry of the OpenMP library that torch has loaded, if it has one that looks like GNU's.

    None in a forked process, which may wait forever for threads that only its parent has.
    """
    if os.getpid() != _PROCESS:
        return None
    try:
        return ctypes.cast(ctypes.CDLL(torch._C.__file__).GOMP_parallel, ctypes.c_void_p)
    except (OSError, AttributeError):
        return None


def _threads(work: int) -> int:
    return torch.get_num_threads() if work >= WORK_FOR_THREADS else 1


def _address(tensor: Tensor | None) -> int | None:
    return None if tensor is None else tensor.data_ptr()
