"""Units of force, torque and length as ATI's devices and files name them."""

_POUND_mN = 4448.2216152605
_INCH_m = 0.0254

FORCES_mN = {
    "N": 1e3,
    "kN": 1e6,
    "g": 9.80665,
    "kg": 9806.65,
    "kgf": 9806.65,
    "lb": _POUND_mN,
    "lbf": _POUND_mN,
    "klb": 1e3 * _POUND_mN,
    "klbf": 1e3 * _POUND_mN,
}
"""How many mN a unit of force is."""

LENGTHS_m = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "in": _INCH_m, "ft": 12 * _INCH_m}
"""How many m a unit of length is."""


def _product(name: str) -> float | None:
    """Return the mN*m of a force and a length, in either order, with or without a hyphen."""
    bare = name.replace("-", "").replace("*", "").replace("·", "")
    for force, mN in FORCES_mN.items():
        for length, m in LENGTHS_m.items():
            if bare in (force + length, length + force):
                return mN * m
    return None


def force_mN(unit: str) -> float:
    """Return how many mN a unit of force is; a ValueError if it is not known."""
    if unit not in FORCES_mN:
        raise ValueError(f"{unit!r} is no unit of force; there are {', '.join(FORCES_mN)}")
    return FORCES_mN[unit]


def length_m(unit: str) -> float:
    """Return how many m a unit of length is; a ValueError if it is not known."""
    if unit not in LENGTHS_m:
        raise ValueError(f"{unit!r} is no unit of length; there are {', '.join(LENGTHS_m)}")
    return LENGTHS_m[unit]


def torque_mNm(unit: str) -> float:
    """Return how many mN*m a unit of torque such as `Nm`, `N-mm` or `in-lb` is; a ValueError if it is not known."""
    found = _product(unit)
    if found is None:
        raise ValueError(f"{unit!r} is no unit of torque, such as N-m, N-mm or in-lb")
    return found
