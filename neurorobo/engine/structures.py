"""The structures of ``native.c``, field by field."""

import ctypes

Integer = ctypes.c_int64
Pointer = ctypes.c_void_p


class Population(ctypes.Structure):
    """Spikes as bits, (steps, batch, words of 64 sources)."""

    _fields_ = (("sources", Integer), ("words", Pointer))


class Weights(ctypes.Structure):
    """Packed weights: multiples of a unit of 8 or 16 bits, or 32-bit floats."""

    _fields_ = (("memory", Pointer), ("unit", ctypes.c_double), ("bits", Integer))


class Projection(ctypes.Structure):
    """What reads a population, with its weights."""

    _fields_ = (
        ("source", Population),
        ("weights", Weights),
        ("index", Pointer),
        ("fan_in", Integer),
    )


Number = ctypes.c_double


class GeneralizedLIF(ctypes.Structure):
    """A leaky integrator, perhaps with a synaptic current and an adaptive threshold."""

    _fields_ = (
        ("threshold", Number),
        ("decay", Number),
        ("input_gain", Number),
        ("synapse_decay", Number),
        ("adaptation", Number),
        ("adaptation_decay", Number),
        ("has_synapse", Integer),
        ("adapts", Integer),
        ("subtracts", Integer),
        ("full", Integer),
    )


class Izhikevich(ctypes.Structure):
    """Izhikevich's neuron."""

    _fields_ = (
        ("b", Number),
        ("c", Number),
        ("d", Number),
        ("input_gain", Number),
        ("peak", Number),
        ("substep", Number),
        ("recovery", Number),
        ("substeps", Integer),
    )


class AdEx(ctypes.Structure):
    """The adaptive exponential neuron."""

    _fields_ = (
        ("rest", Number),
        ("threshold", Number),
        ("inverse_slope", Number),
        ("leak", Number),
        ("upstroke", Number),
        ("a", Number),
        ("b", Number),
        ("reset", Number),
        ("input_gain", Number),
        ("peak", Number),
        ("charging", Number),
        ("recovery", Number),
        ("substeps", Integer),
    )


class SoftUnit(ctypes.Structure):
    """The soft spiking neural unit."""

    _fields_ = (("threshold", Number), ("decay", Number), ("slope", Number))


class Parameters(ctypes.Union):
    """Those of one model."""

    _fields_ = (
        ("generalized_lif", GeneralizedLIF),
        ("izhikevich", Izhikevich),
        ("adex", AdEx),
        ("soft_unit", SoftUnit),
    )


class Model(ctypes.Structure):
    """A neuron that is not the iterative LIF."""

    _fields_ = (
        ("kind", Integer),
        ("variables", Integer),
        ("rest", Number * 3),
        ("shape", Integer),
        ("width", Number),
        ("of", Parameters),
    )


class Window(ctypes.Structure):
    """A layer's window."""

    _fields_ = (
        ("steps", Integer),
        ("batch", Integer),
        ("neurons", Integer),
        ("threads", Integer),
        ("current", Pointer),
        ("projections", Integer),
        ("projection", ctypes.POINTER(Projection)),
        ("recurrent", Weights),
        ("fired", Pointer),
        ("threshold", Pointer),
        ("threshold_stride", Integer),
        ("decay", ctypes.c_double),
        ("rectify", Integer),
        ("spikes", Pointer),
        ("potentials", Pointer),
        ("last", Pointer),
        ("model", ctypes.POINTER(Model)),
        ("before", Pointer),
    )


class Input(ctypes.Structure):
    """Spikes as floats, and where their bits go."""

    _fields_ = (("spikes", Pointer), ("step_stride", Integer), ("batch_stride", Integer), ("to", Population))


class Reading(ctypes.Structure):
    """What a projection reads side by side, and up to how many events of it."""

    _fields_ = (("pieces", Integer), ("piece", ctypes.POINTER(Population)), ("most", Integer))


class Stage(ctypes.Structure):
    """A layer of a circuit."""

    _fields_ = (("window", Window), ("reading", ctypes.POINTER(Reading)), ("from_rest", Integer))


class Circuit(ctypes.Structure):
    """Layers that run in one call."""

    _fields_ = (
        ("inputs", Integer),
        ("input", ctypes.POINTER(Input)),
        ("stages", Integer),
        ("stage", ctypes.POINTER(Stage)),
        ("threads", Integer),
        ("least_work", Integer),
    )


class ScanBack(ctypes.Structure):
    """The scan over time on the way back."""

    _fields_ = (
        ("steps", Integer),
        ("batch", Integer),
        ("neurons", Integer),
        ("threads", Integer),
        ("potentials", Pointer),
        ("grad_spikes", Pointer),
        ("step_stride", Integer),
        ("batch_stride", Integer),
        ("grad_last", Pointer),
        ("later", Pointer),
        ("threshold", Pointer),
        ("threshold_stride", Integer),
        ("decay", ctypes.c_double),
        ("full", Integer),
        ("rectify", Integer),
        ("shape", Integer),
        ("width", ctypes.c_double),
        ("grad_current", Pointer),
        ("grad_threshold", Pointer),
    )


class ModelBack(ctypes.Structure):
    """The way back through a window of neurons that are not LIF."""

    _fields_ = (
        ("steps", Integer),
        ("batch", Integer),
        ("neurons", Integer),
        ("threads", Integer),
        ("model", ctypes.POINTER(Model)),
        ("before", Pointer),
        ("current", Pointer),
        ("grad_sent", Pointer),
        ("step_stride", Integer),
        ("batch_stride", Integer),
        ("grad_state", Pointer),
        ("grad_current", Pointer),
    )


class WeightGradient(ctypes.Structure):
    """The gradient of a projection's weights."""

    _fields_ = (
        ("rows", Integer),
        ("sources", Integer),
        ("targets", Integer),
        ("threads", Integer),
        ("words", Pointer),
        ("grad_current", Pointer),
        ("index", Pointer),
        ("fan_in", Integer),
        ("grad_weight", Pointer),
    )
