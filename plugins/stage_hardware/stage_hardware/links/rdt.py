"""Raw data transfer of ATI's Net F/T: requests, records, their sequence, and what a status word means.

Source: ATI, Net F/T manual 9620-05, on RDT. Unverified on a device: the words of Axia sensors, which have other bits.
"""

import struct
from collections.abc import Sequence
from functools import cache

from stage_hardware.force_sensor import Sample

REQUEST = struct.Struct("!HHI")
"""Header, command and number of records, 0 for no end."""

RECORD = struct.Struct("!IIIiiiiii")
"""rdt_sequence, ft_sequence, status, and six counts: Fx, Fy, Fz, Tx, Ty, Tz."""

HEADER = 0x1234
STOP, START, RESET_LATCH, BIAS = 0x0000, 0x0002, 0x0041, 0x0042
PORT = 49152
FT_RATE_Hz = 7000
"""How fast ft_sequence counts."""

WORD = 2**32
_BEHIND = 2**31
_REMEMBERED = 2**64 - 1

SUMMARY, LATCHED, SATURATED = 1 << 31, 1 << 16, 1 << 17

_NET_FT = {
    30: "processor or memory",
    29: "digital board",
    28: "analog board",
    27: "serial link",
    26: "program memory",
    25: "halted by its configuration",
    24: "settings are invalid",
    23: "configuration does not fit the calibration",
    22: "network",
    21: "CAN",
    20: "RDT",
    19: "EtherNet/IP",
    18: "DeviceNet",
    17: "saturation, or a fault of the converter",
    14: "watchdog",
    13: "stack",
    12: "EEPROM",
    11: "flash memory",
    10: "analog watchdog",
    9: "excitation too high",
    8: "excitation too low",
    7: "ground",
    6: "supply too high",
    5: "supply too low",
    4: "no data of the link",
    3: "reference",
    2: "temperature",
    1: "HTTP",
}
_AXIA = {30: "out of range", 27: "gauge out of range", 2: "broken gauge", 1: "supply", 0: "temperature"}


@cache
def meaning(status: int, *, axia: bool = False) -> tuple[str | None, str | None]:
    """Return the fault and the warning of a status word: a latched threshold is a warning, all else a fault."""
    faults = status & ~SUMMARY if axia else status & ~(SUMMARY | LATCHED)
    warning = "a threshold is latched" if not axia and status & LATCHED else None
    if not faults and (not status & SUMMARY or warning):
        return None, warning
    bits = _AXIA if axia else _NET_FT
    named = [bits.get(bit, f"bit {bit}") for bit in range(31, -1, -1) if faults >> bit & 1]
    return f"status 0x{status:08X}: {', '.join(named) or 'an error that it does not name'}", warning


class Numbers:
    """Numbers of records modulo 2**32, made to grow for ever, with a count of what is missing.

    ``last`` is the number of the last record taken, ``lost`` counts those that had not come before it. A record that is
    not new is refused: ``duplicates`` counts those that had come (among the last 64), ``late`` the others.
    """

    def __init__(self) -> None:
        """Expect number 1."""
        self.last = self.lost = self.duplicates = self.late = 0
        self._came = 0  # bit n: record last - n has come

    def take(self, number: int) -> bool:
        """Return whether the record with this number is new."""
        ahead = (number - self.last) % WORD
        if 0 < ahead < _BEHIND:
            self.last += ahead
            self.lost += ahead - 1
            self._came = (self._came << min(ahead, 64) | 1) & _REMEMBERED
            return True
        if not self._came:  # a stream that begins elsewhere: what came before is not known
            self.last, self._came = number, 1
            return True
        behind = -ahead % WORD
        if behind < 64 and self._came >> behind & 1:
            self.duplicates += 1
        else:
            self.late += 1
        return False


class RecordStream:
    """Turns the records of one stream into samples: sequence, state of the sensor, and units.

    A sensor whose ft_sequence stands still for 1 ms of records has stalled; one whose ft_sequence goes back was
    switched off and on, and is not trusted again in this stream.
    """

    def __init__(
        self,
        rate_Hz: float,
        mN_per_count: float,
        mNm_per_count: float,
        *,
        axia: bool = False,
        warning: str | None = None,
    ) -> None:
        """Prepare it; a ``warning`` goes with all samples."""
        self.numbers = Numbers()
        self._mN, self._mNm, self._axia, self._warning = mN_per_count, mNm_per_count, axia, warning
        self._stalled_after = max(1, round(rate_Hz / 1000))
        self._ft: int | None = None
        self._same = 0
        self._was_restarted = False

    def take(self, time_ns: int, rdt: int, ft: int, status: int, counts: Sequence[int]) -> Sample | None:
        """Return the sample of a record, or None if it is not new."""
        if not self.numbers.take(rdt):
            return None
        fault, warning = meaning(status, axia=self._axia)
        went_on = 1 if self._ft is None else (ft - self._ft) % WORD
        self._ft = ft
        self._same = 0 if went_on else self._same + 1
        if went_on >= _BEHIND:
            self._was_restarted = True
        if self._was_restarted:
            fault = "ft_sequence went back: the box was switched off and on"
        elif self._same >= self._stalled_after:
            fault = f"ft_sequence stays at {ft}: the sensor has stalled"
        if self._warning:
            warning = f"{self._warning}; {warning}" if warning else self._warning
        mN, mNm = self._mN, self._mNm
        fx, fy, fz, tx, ty, tz = counts
        wrench = (fx * mN, fy * mN, fz * mN, tx * mNm, ty * mNm, tz * mNm)
        return Sample(time_ns, self.numbers.last, wrench, self.numbers.lost, fault, warning)
