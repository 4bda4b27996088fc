"""What a time constant becomes in steps of the clock."""

import math

from neurorobo.units import format_duration

SHORTEST = 0.5
"""In steps: of a shorter time constant, less than a seventh of what was there is left after one step."""

LONGEST = 100_000
"""In steps: single precision rounds what is lost of one in a step by up to 0.3 %, and of a longer one by more."""


def left_after(step_ns: int, time_constant_ns: int) -> float:
    """Return what is left of an exponential decay after one step, ``exp(-step / time constant)``."""
    return math.exp(-step_ns / time_constant_ns)


def lost_after(step_ns: int, time_constant_ns: int) -> float:
    """Return what is lost by an exponential decay in one step, ``1 - exp(-step / time constant)``."""
    return -math.expm1(-step_ns / time_constant_ns)


def check_time_constants(step_ns: int, **time_constants_ns: int) -> None:
    """Raise a ValueError if one of the time constants, by their names in a file, is senseless at a step."""
    step = format_duration(step_ns)
    for name, time_constant in time_constants_ns.items():
        said = f"`{name}: {format_duration(time_constant)}`"
        if time_constant < SHORTEST * step_ns:
            raise ValueError(
                f"{said} is shorter than half a spike step of {step}, so that nearly nothing is left after one; "
                "lengthen it, or shorten `time.spike_step`"
            )
        if time_constant > LONGEST * step_ns:
            raise ValueError(
                f"{said} is longer than {LONGEST} spike steps of {step}, in one of which single precision hardly sees "
                "what is lost; shorten it, or lengthen `time.spike_step`"
            )
