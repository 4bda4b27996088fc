"""The load on an emulated force sensor."""

from collections.abc import Callable, Sequence

Wrench = Callable[[float], Sequence[float]]
"""The load at a time of the emulator's clock, in s: three forces in mN, three torques in mN*m."""


def at_rest(time_s: float) -> Sequence[float]:
    """Return no force and no torque at all."""
    return (0.0,) * 6
