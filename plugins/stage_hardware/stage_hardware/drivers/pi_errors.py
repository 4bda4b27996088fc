"""What the error codes of PI controllers mean, and what can be done about them.

Source: PI's own table of codes in PIPython (``pidevice/gcserror.py``); the words are ours.
"""

STOPPED = 10
"""Left by every stop; the only code that is no fault."""

_REFERENCE = "home it; after a power cycle connect again"
_SYNTAX = "see whether this controller knows the command"

_ERRORS = {
    1: ("the syntax of a parameter is wrong", _SYNTAX),
    2: ("the command is unknown", _SYNTAX),
    3: ("the command is too long", "command fewer axes at once"),
    5: ("an axis is not referenced, or its servo is off", _REFERENCE),
    7: ("a position is beyond the limits", "compare the limits with what TMN? and TMX? give"),
    8: ("a velocity is beyond the limits", "lower the speed of the axis"),
    15: ("there is no such axis", "compare the identifiers with what SAI? gives"),
    17: ("a parameter is out of range", _SYNTAX),
    23: ("there is no such axis or channel", "compare the identifiers with what SAI? gives"),
    24: ("the number of parameters is wrong", _SYNTAX),
    25: ("a number cannot be read", _SYNTAX),
    26: ("a parameter is missing", _SYNTAX),
    31: ("the axis has no reference switch", "home it to a limit switch"),
    32: ("the axis has no limit switch", "home it to the reference switch"),
    45: ("the reference move has failed", "see that nothing is in its way, then home it again"),
    49: ("the move to the limit switch has failed", "see that nothing is in its way, then home it again"),
    50: ("referencing is switched off", "connect again"),
    51: ("the axis is under the control of a joystick", "switch the joystick off"),
    53: ("the command is not allowed while the axis moves", "wait until it stands"),
    54: ("the parameter is unknown", _SYNTAX),
    61: ("the automatic zero point procedure is running", "wait until it has ended"),
    63: ("the controller is still starting", "connect again in a moment"),
    216: ("an axis has run onto a limit switch", "find out why, then home it"),
}
_MOTION_ERROR = (
    "the position was too far from where it should be, and the servo has been switched off",
    "see that nothing is in the way, then connect again",
)


def fault_and_cure(code: int) -> tuple[str, str]:
    """Return what an error code says, and what to do."""
    if code in (-1024, 1024):
        return f"{_MOTION_ERROR[0]} (error {code})", _MOTION_ERROR[1]
    fault, cure = _ERRORS.get(code, ("a fault that this driver does not know", "look the code up in the manual"))
    return f"{fault} (error {code})", cure
