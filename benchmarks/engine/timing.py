"""Times of several things to do, taken in turn in one process."""

import ctypes
import gc
import statistics
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path

LEAST_SAMPLE_S = 0.02
"""What takes less is repeated in one sample."""

LEAST_ROUNDS, ENOUGH_S = 5, 20.0
"""So many samples are taken of each; after so many seconds, no more."""


@dataclass
class Contestant:
    """Something to do, ``windows`` of something at once, inside of what ``around`` returns; and its samples."""

    name: str
    once: Callable[[], object]
    windows: int = 1
    around: Callable[[], AbstractContextManager[object]] = nullcontext
    repeats: int = 1
    samples_ms: list[float] = field(default_factory=list)

    def warm_up(self) -> None:
        """Do it until all is in place, and choose how often a sample repeats it."""
        started = time.perf_counter()
        self._do(1)
        if time.perf_counter() - started < LEAST_SAMPLE_S:  # it may not have been in place before
            self.repeats = max(1, round(LEAST_SAMPLE_S / self._do(1)))

    def sample(self) -> None:
        """Take one sample."""
        self.samples_ms.append(1e3 * self._do(self.repeats) / self.repeats / self.windows)

    def times(self) -> dict[str, float]:
        """Return median, least and largest sample for one window, and how many there are."""
        found = (statistics.median(self.samples_ms), min(self.samples_ms), max(self.samples_ms))
        times = {f"{name}_ms": shortened(ms) for name, ms in zip(("median", "min", "max"), found, strict=True)}
        return {**times, "samples": len(self.samples_ms)}

    def _do(self, repeats: int) -> float:
        """Do it so often and return the seconds that it took."""
        with self.around():
            started = time.perf_counter()
            for _ in range(repeats):
                self.once()
            return time.perf_counter() - started


def contest(contestants: Sequence[Contestant], rounds: int) -> None:
    """Take a sample of each, and again, for so many rounds or until there are enough."""
    for contestant in contestants:
        contestant.warm_up()
    gc.collect()
    gc.freeze()  # what is there stays, and is not gone through again
    gc.disable()
    started = time.monotonic()
    for number in range(rounds):
        if number >= LEAST_ROUNDS and time.monotonic() - started > ENOUGH_S:
            break
        for contestant in contestants:
            gc.collect()
            contestant.sample()
    gc.enable()
    gc.unfreeze()


def peak_MB(once: Callable[[], object]) -> float | None:
    """Return how far resident memory rises while something is done, in MB; None if the system does not tell.

    What was freed before is given back to the system first, so that it is counted when it is used again.
    """
    gc.collect()
    try:
        ctypes.CDLL(None).malloc_trim(0)
        Path("/proc/self/clear_refs").write_text("5")  # the peak starts from here
        before_kB = _status_kB("VmRSS")
        once()
        return (_status_kB("VmHWM") - before_kB) / 1e3
    except (OSError, AttributeError):
        return None


def _status_kB(name: str) -> float:
    lines = Path("/proc/self/status").read_text().splitlines()
    (kibibytes,) = (line.split()[1] for line in lines if line.startswith(f"{name}:"))
    return 1.024 * float(kibibytes)


def shortened(number: float) -> float:
    """Return a number with four significant digits."""
    return float(f"{number:.4g}")
