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
