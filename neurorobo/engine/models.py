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
        kind=KINDS.index(type(neuron)),
        variables=variables,
        rest=(structures.Number * 3)(*rest),
        shape=SHAPES[surrogate.shape],
        width=surrogate.width,
    )
    if isinstance(neuron, GeneralizedLIF):
        model.of.generalized_lif = structures.GeneralizedLIF(
            threshold=neuron.threshold,
            decay=neuron.decay,
            input_gain=neuron.input_gain,
            synapse_decay=neuron.synapse_decay or 0.0,
            adaptation=neuron.adaptation or 0.0,
            adaptation_decay=neuron.adaptation_decay,
            has_synapse=neuron.synapse_decay is not None,
            adapts=neuron.adaptation is not None,
            subtracts=neuron.reset == "subtract",
            full=neuron.reset_gradient == "full",
        )
    elif isinstance(neuron, SoftUnit):
        model.of.soft_unit = structures.SoftUnit(threshold=neuron.threshold, decay=neuron.decay, slope=neuron.slope)
    elif isinstance(neuron, Izhikevich):
        substep = neuron.step_ms / neuron.substeps
        model.of.izhikevich = structures.Izhikevich(
            b=neuron.b,
            c=neuron.c,
            d=neuron.d,
            input_gain=neuron.input_gain,
            peak=neuron.peak_mV,
            substep=substep,
            recovery=neuron.a * substep,
            substeps=neuron.substeps,
        )
    else:
        substep = neuron.step_ms / neuron.substeps
        model.of.adex = structures.AdEx(
            rest=neuron.rest_mV,
            threshold=neuron.threshold_mV,
            inverse_slope=1 / neuron.slope_mV,
            leak=neuron.leak_nS,
            upstroke=neuron.leak_nS * neuron.slope_mV,
            a=neuron.a_nS,
            b=neuron.b_pA,
            reset=neuron.reset_mV,
            input_gain=neuron.input_gain,
            peak=neuron.peak_mV,
            charging=substep / neuron.capacitance_pF,
            recovery=substep / neuron.time_constant_ms,
            substeps=neuron.substeps,
        )
    return model
