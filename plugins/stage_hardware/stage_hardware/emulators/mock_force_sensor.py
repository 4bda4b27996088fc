"""A force sensor without a device and without a wire."""

import time
from collections.abc import Mapping

from stage_hardware.emulators.mechanism import Clock
from stage_hardware.emulators.wrench import Wrench
from stage_hardware.errors import LinkError
from stage_hardware.force_sensor import Component, Sample
from stage_hardware.threaded_force_sensor import WAITS_S, ThreadedForceSensor


class MockForceSensor(ThreadedForceSensor):
    """Reads a wrench from a callable, at its rate, in a thread.

    ``wrench`` is given the time of ``clock`` in s and returns the components in their order and units. Faults are
    switches: ``absent`` (it cannot be started), ``silent``, ``fault`` and ``warning`` of the next readings, and
    ``lose``, how many of them are lost.
    """

    def __init__(
        self,
        name: str,
        components: Mapping[str, Component],
        wrench: Wrench,
        *,
        rate_Hz: float = 1000.0,
        silence_s: float = 0.1,
        bias_readings: int = 100,
        clock: Clock = time.monotonic,
    ) -> None:
        """Name it, and what it reads."""
        super().__init__(name, components, rate_Hz, silence_s=silence_s, bias_readings=bias_readings, start_s=0.5)
        self.wrench, self.clock = wrench, clock
        self.absent, self.silent, self.lose = False, False, 0
        self.fault: str | None = None
        self.warning: str | None = None
        self._began_s, self._number, self._lost = 0.0, 0, 0

    def _open(self) -> None:
        if self.absent:
            raise LinkError(self.name, "it is not there", "see to power and network")
        self._began_s, self._number, self._lost = time.monotonic(), 0, 0

    def _shut(self) -> None:
        pass

    def _next(self) -> Sample | None:
        wait_s = self._began_s + self._number / self.rate_Hz - time.monotonic()
        if wait_s > 0:
            time.sleep(min(wait_s, WAITS_S))
            if wait_s > WAITS_S:
                return None
        self._number += 1
        if self.silent:
            return None
        if self.lose > 0:
            self.lose, self._lost = self.lose - 1, self._lost + 1
            return None
        values = tuple(self.wrench(self.clock()))
        return Sample(time.monotonic_ns(), self._number, values, self._lost, self.fault, self.warning)
