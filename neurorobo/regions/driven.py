"""A layer that is driven by more than its projections."""

from collections.abc import Sequence

from torch import Tensor

from neurorobo.engine.checked import check_spikes
from neurorobo.engine.events import Population, is_native, run_events
from neurorobo.engine.kernels import kernels
from neurorobo.engine.layer import Layer
from neurorobo.engine.window import run_window
from neurorobo.neurons import LIF
from neurorobo.synapses import Dense


def run_driven(layer: Layer, inputs: Sequence[Tensor], current: Tensor) -> Tensor:
    """Run one window of a layer of LIF neurons from rest, with a current besides those of its projections.

    ``inputs`` are the spikes (steps, batch, sources) of each projection; ``current`` (steps, batch, neurons) is given
    away: it may be overwritten. Returns the spikes (steps, batch, neurons). Both paths of the engine give the same ones
    if weights and current are multiples of one power of two. Raises a ValueError for other neurons, for synapses among
    them, for weights of other shapes than the layer's, and for spikes that are neither 0 nor 1.
    """
    neuron = layer.neuron
    if type(neuron) is not LIF or layer.recurrent is not None:
        raise ValueError("only a layer of LIF neurons without synapses among themselves can be driven")
    projections = [projection for projection in layer.projections if isinstance(projection, Dense)]
    rest, native = layer.at_rest(current.shape[1]), kernels()
    layer.check_parameters()
    if (
        native is not None
        and len(projections) == len(layer.projections)
        and is_native(current, *inputs, *layer.parameters())
    ):
        population = Population(neuron, [None] * len(projections), layer.checked)
        weights = [projection.weight for projection in projections]
        return run_events(native, population, inputs, weights, rest, layer.threshold, None, current)[0]
    for projection, spikes in zip(layer.projections, inputs, strict=True):
        check_spikes(spikes)
        current = current + projection(spikes)
    return run_window(current, rest, neuron, layer.threshold)[0]
