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

    A full collection goes through all that was ever imported and holds up every thread meanwhile; a page of code that
    was put away has to be read from the disk. Locking memory needs a limit that allows it (``ulimit -l``); without, it
    is left out.
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
