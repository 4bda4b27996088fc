"""ATI's Net F/T box: a wrench in each UDP datagram.

Source: ATI, Net F/T manual 9620-05, on RDT. Not tried on a device. The box serves one client, that which asked last.
"""

import socket
import time
from dataclasses import dataclass

from stage_hardware.drivers.net_ft_sensor import NetFtSensor
from stage_hardware.errors import HardwareError, LinkError, RefusedError
from stage_hardware.force_sensor import WRENCH, Sample
from stage_hardware.links import rdt
from stage_hardware.links.net_ft_page import NetFtSettings, read_settings
from stage_hardware.threaded_force_sensor import WAITS_S

ASKS_AGAIN_S = 0.1
"""How long a request for the stream may be without an answer: it may have been lost."""

BUFFER_BYTES = 2**20
"""What the operating system is asked to keep of a stream while this process does not run."""


@dataclass(frozen=True)
class RdtCounts:
    """What has come since the start: records taken, lost, and refused.

    Refused are ``duplicates``, those that came too ``late`` (after one that was sent after them; they count as lost
    too), ``malformed`` datagrams, and ``foreign`` ones, from another address or port than the box's.
    """

    taken: int
    lost: int
    duplicates: int
    late: int
    malformed: int
    foreign: int


class AtiNetFt(NetFtSensor):
    """A force sensor behind a Net F/T box, unbiased on the box, biased on the host.

    Of the box's settings, units, counts per unit, range and rate are read when it starts, and have to fit. It is never
    made to change them. A stream that another client took over is not taken back: :meth:`latest` tells of the silence.
    The time of a reading is when its datagram is taken from the system: after a pause of this process, those that have
    waited look younger than they are, until the last of them is taken.
    """

    def _prepare(self) -> None:
        self._socket: socket.socket | None = None
        self._box = ("", 0)
        self._asked = 0.0
        self._stream = rdt.RecordStream(self.rate_Hz, 1.0, 1.0)
        self._taken = self._malformed = self._foreign = 0

    @property
    def counts(self) -> RdtCounts:
        """What has come since the start."""
        numbers = self._stream.numbers
        return RdtCounts(self._taken, numbers.lost, numbers.duplicates, numbers.late, self._malformed, self._foreign)

    def _open(self) -> None:
        settings = read_settings(self.name, self.host, self.http_port, self.timeout_s)
        self._check(settings)
        self._stream = rdt.RecordStream(
            self.rate_Hz,
            settings.mN_per_count,
            settings.mNm_per_count,
            axia=settings.is_axia,
            warning="the box subtracts a bias of its own" if settings.has_bias else None,
        )
        self._taken = self._malformed = self._foreign = 0
        try:
            self._box = (socket.gethostbyname(self.host), self.rdt_port)
            # A new port for each start: what a stream from before may still bring goes to the old one.
            self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
            self._socket.bind(("", 0))
            self._socket.settimeout(WAITS_S)
            self._send(rdt.START)
        except OSError as error:
            raise LinkError(
                self.name, f"no datagram can be sent to {self.host} ({error})", "see to network and address"
            ) from error

    def _check(self, settings: NetFtSettings) -> None:
        if not settings.is_enabled:
            raise RefusedError(self.name, "RDT is disabled", "enable it on the box's page of communications")
        if settings.rate_Hz is not None and abs(settings.rate_Hz - self.rate_Hz) > 0.01 * self.rate_Hz:
            raise HardwareError(
                self.name,
                f"the box sends {settings.rate_Hz:g} readings a second, not {self.rate_Hz:g}",
                "set the rate on its page of communications, or expect that one",
            )
        for name, largest in zip(WRENCH, settings.ranges or (), strict=False):
            component = self.components[name]
            if abs(largest - component.largest) > 0.01 * component.largest:
                raise HardwareError(
                    self.name,
                    f"the box is set up for {name} up to {largest:g} {component.unit}, not {component.largest:g}",
                    "select the configuration of this sensor on its page, or expect that one",
                )

    def _shut(self) -> None:
        opened, self._socket = self._socket, None
        if opened is None:
            return
        last = self._last
        try:
            # Without records of late, the stream may be another client's, which is not to be stopped.
            if last is not None and time.monotonic_ns() - last.time_ns < self.silence_s * 1e9:
                opened.sendto(rdt.REQUEST.pack(rdt.HEADER, rdt.STOP, 0), self._box)
        except OSError:
            pass  # it is gone anyway
        opened.close()

    def _send(self, command: int) -> None:
        assert self._socket is not None
        self._socket.sendto(rdt.REQUEST.pack(rdt.HEADER, command, 0), self._box)
        self._asked = time.monotonic()

    def _next(self) -> Sample | None:
        opened = self._socket
        if opened is None:
            return None
        if self._last is None and time.monotonic() - self._asked > ASKS_AGAIN_S:
            self._send(rdt.START)
        try:
            datagram, source = opened.recvfrom(2048)
        except (TimeoutError, ConnectionError):  # the latter says that nobody listens there, on some systems
            return None
        time_ns = time.monotonic_ns()
        if source != self._box:
            self._foreign += 1
            return None
        if len(datagram) != rdt.RECORD.size:
            self._malformed += 1
            return None
        number, ft, status, *counts = rdt.RECORD.unpack(datagram)
        sample = self._stream.take(time_ns, number, ft, status, counts)
        if sample is not None:
            self._taken += 1
        return sample

    def _hint(self) -> str:
        counts = self.counts
        refused = {
            "from another address or port": counts.foreign,
            "malformed": counts.malformed,
            "late": counts.late,
            "twice": counts.duplicates,
        }
        came = ", ".join(f"{count} {how}" for how, count in refused.items() if count)
        return f" (another client has the stream, or the box is off; refused so far: {came or 'nothing'})"
