"""Pauses of the machine: when a processor ran nothing, not even what goes before everything else.

A virtual machine shares its processors with others that its own system does not see, and stands still at times. On each
processor a process with the priority of a real-time program sleeps for some milliseconds at a time, and notes when that
took longer. What delays it is neither the load of this machine nor anything that a program on it could do better.
"""

import multiprocessing
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection

SLEEPS_S = 0.004
PAUSE_NS = 5_000_000
"""By how much a sleep is longer at least, to be called a pause."""


@dataclass(frozen=True)
class Pause:
    """When a processor was to run something, and when it did, in ns of the monotonic clock."""

    began_ns: int
    ended_ns: int

    def within_ns(self, began_ns: int, ended_ns: int) -> int:
        """Return how much of it lies in an interval."""
        return max(0, min(self.ended_ns, ended_ns) - max(self.began_ns, began_ns))


@contextmanager
def pauses_of_the_machine() -> Iterator[list[Pause]]:
    """Yield a list that has all pauses of all processors when the block has ended.

    It stays empty where the priority of a real-time program is not to be had: without, a busy machine looks the same.
    """
    found: list[Pause] = []
    if sys.platform != "linux":
        yield found
        return
    spawn = multiprocessing.get_context("spawn")
    watches = []
    for processor in os.sched_getaffinity(0):
        pipe, theirs = spawn.Pipe()
        process = spawn.Process(target=_watch, args=(processor, theirs), daemon=True)
        process.start()
        pipe.recv()
        watches.append((process, pipe))
    try:
        yield found
    finally:
        for process, pipe in watches:
            pipe.send(None)
            found += pipe.recv()
            process.join()


def _watch(processor: int, pipe: Connection) -> None:
    """Watch one processor until told to end, then tell its pauses."""
    pauses: list[Pause] = []
    os.sched_setaffinity(0, {processor})
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(os.sched_get_priority_max(os.SCHED_FIFO) // 2))
        is_first = True
    except PermissionError:
        is_first = False
    pipe.send(None)
    while not pipe.poll():
        due_ns = time.monotonic_ns() + round(SLEEPS_S * 1e9)
        time.sleep(SLEEPS_S)
        woke_ns = time.monotonic_ns()
        if is_first and woke_ns - due_ns > PAUSE_NS:
            pauses.append(Pause(due_ns, woke_ns))
    pipe.send(pauses)
