"""A DAQ F/T sensor of ATI: six gauge voltages of a data acquisition card, and the sensor's calibration.

Not tried on a device. The card is the caller's: a :data:`VoltageSource` reads it.
"""

import math
import time
from collections.abc import Callable, Sequence

from stage_hardware.drivers.ati_calibration import GAUGES, AtiCalibration
from stage_hardware.force_sensor import Sample
from stage_hardware.threaded_force_sensor import WAITS_S, ThreadedForceSensor

VoltageSource = Callable[[], Sequence[float]]
"""Returns the present voltages of the six gauges, in V, in the order of the calibration, and soon: within 20 ms."""

SATURATED = 0.99
"""Which share of its full scale a gauge that is saturated gives, at least: one makes all components wrong."""


class AtiDaq(ThreadedForceSensor):
    """A force sensor whose gauges are read at ``rate_Hz``; readings that come due meanwhile count as lost.

    A gauge at its end or without a number makes a reading invalid, as does a source that raises an exception all
    readings to come.
    """

    def __init__(
        self,
        name: str,
        calibration: AtiCalibration,
        voltages: VoltageSource,
        *,
        rate_Hz: float = 1000.0,
        resolution_mN: float,
        resolution_mNm: float,
        silence_s: float = 0.1,
        bias_readings: int = 100,
    ) -> None:
        """Name the sensor, its calibration and the source of its voltages; resolutions are on its data sheet."""
        components = calibration.components(resolution_mN=resolution_mN, resolution_mNm=resolution_mNm)
        super().__init__(name, components, rate_Hz, silence_s=silence_s, bias_readings=bias_readings)
        self.calibration, self.voltages = calibration, voltages
        self._began_s, self._taken, self._lost = 0.0, 0, 0

    def _open(self) -> None:
        self._began_s, self._taken, self._lost = time.monotonic(), 0, 0

    def _shut(self) -> None:
        pass

    def _next(self) -> Sample | None:
        number = self._taken + self._lost
        wait_s = self._began_s + number / self.rate_Hz - time.monotonic()
        if wait_s > 0:
            time.sleep(min(wait_s, WAITS_S))
            if wait_s > WAITS_S:
                return None
        time_ns = time.monotonic_ns()
        gauges_V = self.voltages()
        due = int((time_ns / 1e9 - self._began_s) * self.rate_Hz)
        self._lost += max(0, due - number)
        self._taken += 1
        values = tuple(self.calibration.wrench(gauges_V).tolist()) if len(gauges_V) == GAUGES else (math.nan,) * 6
        return Sample(time_ns, self._taken + self._lost, values, self._lost, self._fault(gauges_V))

    def _fault(self, gauges_V: Sequence[float]) -> str | None:
        if len(gauges_V) != GAUGES:
            return f"{len(gauges_V)} voltages came, not {GAUGES}"
        largest_V = SATURATED * self.calibration.full_scale_V
        for gauge, voltage_V in enumerate(gauges_V):
            if not abs(voltage_V) < largest_V:  # nor is a NaN
                return f"gauge G{gauge} is saturated: {voltage_V:.2f} V of {self.calibration.full_scale_V:g} V"
        return None
