"""Codes on the native path: they count the spikes of a few neurons, in less time than torch takes for one operation."""

from torch import Tensor

from neurorobo.codes import CoarseFine, Code, CountCode, Poisson, PopulationNested, PopulationUniform
from neurorobo.codes.rate import nested_firsts
from neurorobo.engine.events import is_native
from neurorobo.engine.kernels import Kernels, kernels


def encode(code: Code, values: Tensor, steps: int) -> Tensor:
    """Return what ``code.encode(values, steps)`` does, bit for bit."""
    native = kernels()
    if native is not None and is_native(values):
        batch, width = values.shape
        spikes = native.empty((steps, batch, width, code.neurons))
        if isinstance(code, CoarseFine):
            done = _encode(native, code.coarse, values, spikes, 0)
            done = done and _encode(native, code.fine, values, spikes, code.coarse.neurons)
        else:
            done = _encode(native, code, values, spikes, 0)
        if done:
            return spikes.view(steps, batch, width * code.neurons)
    return code.encode(values, steps)


def _encode(native: Kernels, code: Code, values: Tensor, spikes: Tensor, after: int) -> bool:
    """Write the spikes of a code behind so many neurons of each value; False if that is to be done elsewhere."""
    kind = type(code)
    if kind is PopulationUniform:
        firsts = None
    elif kind is PopulationNested:
        firsts = nested_firsts(code.neurons, spikes.shape[0])
    else:
        return False
    return native.encode(values, code.lo, code.hi, firsts, spikes, code.neurons, after)


def decode(code: Code, spikes: Tensor) -> Tensor:
    """Return what ``code.decode(spikes)`` does, bit for bit, and as differentiable."""
    kind = type(code)
    if (kind is PopulationUniform or kind is PopulationNested or kind is Poisson) and not spikes.requires_grad:
        native = kernels()
        if native is not None and is_native(spikes) and spikes.shape[-1] % code.neurons == 0:
            assert isinstance(code, CountCode)
            return native.decode(spikes, code.neurons, code.lo, code.resolution(spikes.shape[0]))
    return code.decode(spikes)
