"""Codes on the native path: they count the spikes of a few neurons, in less time than torch takes for one operation."""

from torch import Tensor

from neurorobo.codes import CoarseFine, Code, CountCode, Poisson, PopulationNested, PopulationUniform
from neurorobo.codes.rate import nested_firsts
from neurorobo.engine.events import is_native
from neurorobo.engine.kernels import kernels


def encode(code: Code, values: Tensor, steps: int) -> Tensor:
    """Return what ``code.encode(values, steps)`` does, bit for bit."""
    kind = type(code)
    if kind is CoarseFine:
        assert isinstance(code, CoarseFine)
        return code.joined(encode(code.coarse, values, steps), encode(code.fine, values, steps))
    if kind is PopulationUniform or kind is PopulationNested:
        native = kernels()
        if native is not None and is_native(values):
            firsts = nested_firsts(code.neurons, steps) if kind is PopulationNested else None
            spikes = native.encode(values, steps, code.neurons, code.lo, code.hi, firsts)
            if spikes is not None:
                return spikes
    return code.encode(values, steps)


def decode(code: Code, spikes: Tensor) -> Tensor:
    """Return what ``code.decode(spikes)`` does, bit for bit, and as differentiable."""
    kind = type(code)
    if (kind is PopulationUniform or kind is PopulationNested or kind is Poisson) and not spikes.requires_grad:
        native = kernels()
        if native is not None and is_native(spikes) and spikes.shape[-1] % code.neurons == 0:
            assert isinstance(code, CountCode)
            return native.decode(spikes, code.neurons, code.lo, code.resolution(len(spikes)))
    return code.decode(spikes)
