"""What numbers of a Venus controller stand for: errors, units and bits."""

ERRORS = {
    1001: "an argument is of the wrong type",
    1002: "there are too few arguments",
    1003: "there are too few arguments, or one is out of range",
    1004: "the target is out of range",
    1007: "an argument is out of range",
    1008: "there are too few arguments",
    1009: "its stack is full",
    1010: "it has no memory left",
    1015: "the position is outside its working range",
    2000: "it does not know a word",
}

MM = 2
"""The number of that unit."""

LENGTHS_MM = {1: 1e-3, 2: 1.0, 3: 10.0, 4: 1000.0, 5: 25.4, 6: 0.0254}
"""Units by number, but for 0, a microstep."""


class Bits:
    """The status of an axis in Venus-2."""

    EXECUTING = 0x01
    MANUAL = 0x02
    MACHINE_ERROR = 0x04
    LIMITED = 0x40
    MOTOR_OFF = 0x80


def told(code: int) -> str:
    """Return an error in words."""
    words = "an error of its own" if 1 <= code <= 4 else ERRORS.get(code, "an error that this driver does not know")
    return f"{words} (error {code})"
