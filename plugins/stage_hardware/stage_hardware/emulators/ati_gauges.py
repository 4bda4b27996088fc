"""The gauges of an emulated DAQ F/T sensor: what a card would read under a wrench."""

import math
import time

import numpy as np

from stage_hardware.drivers.ati_calibration import AtiCalibration
from stage_hardware.emulators.mechanism import Clock
from stage_hardware.emulators.wrench import Wrench, at_rest


class AtiGauges:
    """A source of voltages (V): those that a calibration turns into a wrench, and that are at rest ``zero_V``.

    They end at full scale. Faults are switches: ``broken`` names a gauge that gives no number, ``unplugged`` lets the
    card fail, ``slow_s`` is how long it takes.
    """

    def __init__(
        self,
        calibration: AtiCalibration,
        wrench: Wrench = at_rest,
        *,
        zero_V: tuple[float, ...] = (0.0,) * 6,
        clock: Clock = time.monotonic,
    ) -> None:
        """Take the inverse of a calibration; a numpy.linalg.LinAlgError if it has none."""
        self.wrench, self.clock, self.full_scale_V = wrench, clock, calibration.full_scale_V
        self.broken: int | None = None
        self.unplugged, self.slow_s = False, 0.0
        self._inverse, self._zero_V = np.linalg.inv(calibration.matrix), zero_V

    def __call__(self) -> list[float]:
        """Return the voltages of all gauges now."""
        if self.slow_s:
            time.sleep(self.slow_s)
        if self.unplugged:
            raise OSError("the card does not answer")
        voltages = self._inverse @ np.asarray(self.wrench(self.clock()), dtype=float) + self._zero_V
        gauges_V: list[float] = np.clip(voltages, -self.full_scale_V, self.full_scale_V).tolist()
        if self.broken is not None:
            gauges_V[self.broken] = math.nan
        return gauges_V
