"""A force sensor that is read in a thread: its readings, its bias, and its silence."""

import math
import threading
import time
from abc import abstractmethod
from collections.abc import Mapping

from stage_hardware.errors import HardwareError, ReplyTimeoutError
from stage_hardware.force_sensor import Component, ForceReading, ForceSensor, Sample, Watcher

WAITS_S = 0.02
"""How long :meth:`ThreadedForceSensor._next` waits at most, so that a stop is never slow."""


class _Mean:
    """The mean of the samples to come, or the fault of one of them."""

    def __init__(self, count: int) -> None:
        self.count = count
        self.fault: str | None = None
        self.done = threading.Event()
        self._came: list[tuple[float, ...]] = []

    def __len__(self) -> int:
        return len(self._came)

    def add(self, sample: Sample) -> None:
        """Take a sample, unless there are enough."""
        if self.done.is_set():
            return
        self.fault = sample.fault
        self._came.append(sample.values)
        if self.fault is not None or len(self) == self.count:
            self.done.set()

    def values(self) -> tuple[float, ...]:
        """Return the mean."""
        return tuple(math.fsum(values) / len(self) for values in zip(*self._came, strict=True))


class ThreadedForceSensor(ForceSensor):
    """What all sensors share that are read in a thread; one of them says how to open, to read and to shut it.

    After ``silence_s`` without a sample, :meth:`latest` is not valid. A bias is the mean of ``bias_readings`` samples.
    """

    def __init__(
        self,
        name: str,
        components: Mapping[str, Component],
        rate_Hz: float,
        *,
        silence_s: float = 0.1,
        start_s: float = 2.0,
        bias_readings: int = 100,
    ) -> None:
        """Remember what is known before connecting; :meth:`start` waits for ``start_s`` at most."""
        super().__init__(name, components, rate_Hz)
        self.silence_s, self.start_s, self.bias_readings = silence_s, start_s, bias_readings
        self._names = tuple(components)
        self._offset = (0.0,) * len(self._names)
        self._last: Sample | None = None
        self._failure: str | None = "it was not started"
        self._mean: _Mean | None = None
        self._watchers: tuple[Watcher, ...] = ()
        self._thread: threading.Thread | None = None
        self._ends, self._began = threading.Event(), threading.Event()

    @abstractmethod
    def _open(self) -> None:
        """Connect and ask for samples; a HardwareError if that cannot be."""

    @abstractmethod
    def _next(self) -> Sample | None:
        """Return the next sample, or None if there is none within :data:`WAITS_S` or so."""

    @abstractmethod
    def _shut(self) -> None:
        """Disconnect; safe to call twice."""

    def _hint(self) -> str:
        """Return what may be said of a silence."""
        return ""

    def start(self) -> None:
        """Connect and begin to read; what bias there was is kept."""
        self.stop()
        self._last, self._failure = None, None
        self._ends, self._began = threading.Event(), threading.Event()
        try:
            self._open()
            self._thread = threading.Thread(
                target=self._read, args=(self._ends,), name=f"read {self.name}", daemon=True
            )
            self._thread.start()
            self._began.wait(self.start_s)
            if self._failure is not None:
                raise HardwareError(self.name, self._failure, "see to it, then start again")
            if self._last is None:
                raise ReplyTimeoutError(
                    self.name,
                    f"no reading within {self.start_s:g} s{self._hint()}",
                    "see to power, network and firewall",
                )
        except BaseException:
            self.stop()
            raise

    def stop(self) -> None:
        """End the reading."""
        self._ends.set()
        thread, self._thread = self._thread, None
        if thread is not None and thread is not threading.current_thread():
            thread.join(timeout=2)
        self._shut()
        self._failure = "it was stopped" if self._last is not None else "it was not started"

    def bias(self) -> None:
        """Count from the mean of the next samples, on the host; a HardwareError if one is faulty, or too few come."""
        if self._failure is not None:
            raise HardwareError(self.name, f"no bias: {self._failure}", "start it first")
        mean = self._mean = _Mean(self.bias_readings)
        in_time = mean.done.wait(2 * self.bias_readings / self.rate_Hz + 1.0)
        self._mean = None
        if mean.fault is not None:
            raise HardwareError(self.name, f"no bias: {mean.fault}", "see to the sensor, then bias again")
        if not in_time:
            fault = f"no bias: only {len(mean)} of {self.bias_readings} readings came{self._hint()}"
            raise ReplyTimeoutError(self.name, fault, "see to power and network, then start and bias again")
        self._offset = mean.values()

    def watch(self, watcher: Watcher) -> None:
        """Hand each reading to a watcher from now on."""
        self._watchers = (*self._watchers, watcher)

    def latest(self) -> ForceReading:
        """Return the last reading, with the fault that it has become too old, if so."""
        last, failure = self._last, self._failure
        if last is None:
            nothing = dict.fromkeys(self._names, math.nan)
            return ForceReading(0, 0, nothing, nothing, fault=failure or "no reading has come yet")
        if failure is None and (silent_ns := time.monotonic_ns() - last.time_ns) > self.silence_s * 1e9:
            failure = f"no reading for {silent_ns / 1e9:.2f} s{self._hint()}"
        return self._reading(last, failure)

    def _reading(self, sample: Sample, failure: str | None = None) -> ForceReading:
        names, came = self._names, sample.values
        unbiased = dict(zip(names, came, strict=True))
        values = {name: value - zero for name, value, zero in zip(names, came, self._offset, strict=True)}
        fault = failure or sample.fault
        return ForceReading(sample.time_ns, sample.sequence, values, unbiased, sample.lost, fault, sample.warning)

    def _read(self, ends: threading.Event) -> None:
        try:
            while not ends.is_set():
                sample = self._next()
                if sample is not None and not ends.is_set():
                    self._take(sample)
        except Exception as error:  # whatever ends the thread ends the readings, and has to be seen
            if not ends.is_set():
                self._failure = error.fault if isinstance(error, HardwareError) else str(error) or type(error).__name__
        self._began.set()

    def _take(self, sample: Sample) -> None:
        self._last = sample
        if self._mean is not None:
            self._mean.add(sample)
        if self._watchers:
            reading = self._reading(sample)
            for watcher in self._watchers:
                watcher(reading)
        if not self._began.is_set():
            self._began.set()
