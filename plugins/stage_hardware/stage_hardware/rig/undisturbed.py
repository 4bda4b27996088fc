"""What keeps a process from being late for reasons of its own: collections of garbage, and pages that were put away."""

import ctypes
import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager

CURRENT, FUTURE, ON_FAULT = 1, 2, 4
"""The flags of ``mlockall``, as Linux has them."""


@contextmanager
def undisturbed() -> Iterator[None]:
    """Neither collect again what is there already, nor let the system put away what was used, until the end.

    A full collection of all that is imported holds up every thread for some 0.1 s, and a page of code that has to be
    read again for some 0.02 s. Locking memory needs a limit that allows it (``ulimit -l``); without, it is left out.
    """
    gc.collect()
    gc.freeze()
    is_locked = sys.platform == "linux" and ctypes.CDLL(None).mlockall(CURRENT | FUTURE | ON_FAULT) == 0
    try:
        yield
    finally:
        if is_locked:
            ctypes.CDLL(None).munlockall()
        gc.unfreeze()
