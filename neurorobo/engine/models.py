"""Which neurons the native path has besides the iterative LIF, and what it needs to know of them."""

from functools import cache

from neurorobo.engine import structures
from neurorobo.neurons import LIF, Neuron
from neurorobo.neurons.bidimensional import AdEx, Izhikevich
from neurorobo.neurons.generalized_lif import GeneralizedLIF
from neurorobo.neurons.soft_unit import SoftUnit
from neurorobo.neurons.surrogate import Surrogate

SHAPES = {"rectangular": 0, "triangular": 1, "arctan": 2, "fast_sigmoid": 3}

KINDS = (GeneralizedLIF, Izhikevich, AdEx, SoftUnit)
"""In the order of their numbers in ``models.h``."""


def is_on_native_path(neuron: Neuron, *, recurrent: bool) -> bool:
    """Return whether the kernels have a neuron, in layers that are ``recurrent`` or not.

    Soft units send one another numbers, of which there are no events.
    """
    return type(neuron) is LIF or (type(neuron) in KINDS and not (recurrent and sends_numbers(neuron)))


def sends_numbers(neuron: Neuron) -> bool:
    """Return whether a neuron of the core sends numbers in place of spikes."""
    return type(neuron) is SoftUnit


def carried(neuron: Neuron, neurons: int, *, recurrent: bool) -> int:
    """Return how many numbers of each batch element a state has that the kernels take."""
    if type(neuron) is LIF:
        return neurons
    model = native_model(neuron)
    assert model is not None
    variables: int = model.variables
    return (variables + recurrent) * neurons


def native_model(neuron: Neuron) -> structures.Model | None:
    """Return what the kernels need to know of a neuron, or None of one that they do not have; those of LIF apart."""
    return _model(neuron) if type(neuron) in KINDS else None  # type: ignore[arg-type]


@cache  # neurons are frozen
def _model(neuron: GeneralizedLIF | Izhikevich | AdEx | SoftUnit) -> structures.Model:
    rest = neuron.resting_state if isinstance(neuron, Izhikevich | AdEx) else ()
    variables = neuron.variables if isinstance(neuron, GeneralizedLIF) else max(1, len(rest))
    surrogate = Surrogate() if isinstance(neuron, SoftUnit) else neuron.surrogate
    model = structures.Model(
        KINDS.index(type(neuron)), variables, (structures.Number * 3)(*rest), SHAPES[surrogate.shape], surrogate.width
    )
    if isinstance(neuron, GeneralizedLIF):
        model.of.generalized_lif = structures.GeneralizedLIF(
            neuron.threshold,
            neuron.decay,
            neuron.input_gain,
            neuron.synapse_decay or 0.0,
            neuron.adaptation or 0.0,
            neuron.adaptation_decay,
            neuron.synapse_decay is not None,
            neuron.adaptation is not None,
            neuron.reset == "subtract",
            neuron.reset_gradient == "full",
        )
    elif isinstance(neuron, SoftUnit):
        model.of.soft_unit = structures.SoftUnit(neuron.threshold, neuron.decay, neuron.slope)
    else:
        substep = neuron.step_ms / neuron.substeps
        if isinstance(neuron, Izhikevich):
            model.of.izhikevich = structures.Izhikevich(
                neuron.b,
                neuron.c,
                neuron.d,
                neuron.input_gain,
                neuron.peak_mV,
                substep,
                neuron.a * substep,
                neuron.substeps,
            )
        else:
            model.of.adex = structures.AdEx(
                neuron.rest_mV,
                neuron.threshold_mV,
                1 / neuron.slope_mV,
                neuron.leak_nS,
                neuron.leak_nS * neuron.slope_mV,
                neuron.a_nS,
                neuron.b_pA,
                neuron.reset_mV,
                neuron.input_gain,
                neuron.peak_mV,
                substep / neuron.capacitance_pF,
                substep / neuron.time_constant_ms,
                neuron.substeps,
            )
    return model
