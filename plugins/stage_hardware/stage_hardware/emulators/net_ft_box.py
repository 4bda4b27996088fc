"""An emulated Net F/T box: records over UDP at their rate, its page over HTTP.

It takes the newest request for the one to serve, counts records from 1 with each start, and obeys whoever asks it to
stop or to bias, as a box is believed to do; its bias is lost with the power. It does not know the buffered and the
synchronised mode.
"""

import select
import socket
import threading
import time
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from operator import mul
from typing import Self

import numpy as np

from stage_hardware.emulators.faults import RdtFaults
from stage_hardware.emulators.mechanism import Clock
from stage_hardware.emulators.wrench import Wrench, at_rest
from stage_hardware.links import rdt

Client = tuple[str, int]

IDLE_S = 0.05
GRAIN_S = 0.001
"""Records of a stream that is faster than this are sent in bursts, which costs less."""

_COUNT = 2**31


class NetFtBox:
    """A box on 127.0.0.1, on free ports, served by threads between :meth:`start` and :meth:`close`.

    Faults are set on ``faults`` at any time; beyond those, each record is lost with the probability ``loss``, drawn
    from ``generator``. ``page`` holds the elements of its page, and may be changed. ``sent`` counts the records of the
    present stream, also those that were lost: they are in ``lost``, by number.
    """

    def __init__(
        self,
        wrench: Wrench = at_rest,
        *,
        rate_Hz: float = 1000.0,
        forces_N: tuple[float, float, float] = (18.0, 18.0, 18.0),
        torques_Nmm: tuple[float, float, float] = (250.0, 250.0, 250.0),
        first: int = 1,
        loss: float = 0.0,
        generator: np.random.Generator | None = None,
        clock: Clock = time.monotonic,
    ) -> None:
        """Prepare it; ``first`` is the number of the first record of a stream."""
        self.wrench, self.rate_Hz, self.first, self.loss, self.clock = wrench, rate_Hz, first, loss, clock
        self.generator = np.random.default_rng(0) if generator is None else generator
        self.faults = RdtFaults()
        self.page = {
            "prodname": "Emulated Net F/T",
            "setserial": "000000",
            "setcfgsel": "0",
            "runstat": "0x00000000",
            "setbias": "0;0;0;0;0;0",
            "cfgcpf": "1000000",
            "cfgcpt": "1000000",
            "scfgfu": "N",
            "scfgtu": "Nmm",
            "cfgmr": ";".join(f"{largest:g}" for largest in (*forces_N, *torques_Nmm)),
            "comrdte": "Enabled",
            "comrdtrate": f"{rate_Hz:g}",
            "comrdtbsiz": "40",
        }
        self.sent = 0
        self.lost: list[int] = []
        self.stopped = 0
        self._counts_per = (1e3,) * 3 + (1e6,) * 3
        self._client: Client | None = None
        self._left = 0
        self._held: bytes | None = None
        self._bias: tuple[float, ...] = (0.0,) * 6
        self._last = self._bias
        self._power_on_s = self._began_s = clock()
        self._ft = 0
        self._elsewhere: socket.socket | None = None
        self._ends = threading.Event()
        self._threads: list[threading.Thread] = []

    @property
    def host(self) -> str:
        """Its address."""
        return "127.0.0.1"

    @property
    def rdt_port(self) -> int:
        """The port of its records."""
        port: int = self._socket.getsockname()[1]
        return port

    @property
    def http_port(self) -> int:
        """The port of its page."""
        return self._server.server_port

    def start(self) -> Self:
        """Open the ports and begin to answer."""
        self._socket, self._other = _bound(self.host, 0), _bound(self.host, 0)
        self._server = ThreadingHTTPServer((self.host, 0), self._handler())
        self._server.daemon_threads = True
        for run in (self._serve, lambda: self._server.serve_forever(IDLE_S)):
            self._threads.append(threading.Thread(target=run, name="emulated Net F/T", daemon=True))
            self._threads[-1].start()
        return self

    def close(self) -> None:
        """End; safe to call twice."""
        if not self._threads:
            return
        self._ends.set()
        self._server.shutdown()
        for thread in self._threads:
            thread.join()
        self._threads.clear()
        self._server.server_close()
        for opened in (self._socket, self._other, self._elsewhere):
            if opened is not None:
                opened.close()

    def __enter__(self) -> Self:
        """Start."""
        return self.start()

    def __exit__(self, *_: object) -> None:
        """Close."""
        self.close()

    def power_cycle(self) -> None:
        """Switch it off and on: the stream ends, ft_sequence begins anew, and its bias is lost."""
        self._client, self._power_on_s = None, self.clock()
        self._bias = (0.0,) * 6

    def _handler(self) -> type[BaseHTTPRequestHandler]:
        box = self

        class Page(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                box._ends.wait(box.faults.slow_page_s)
                if self.path.partition("?")[0] != "/netftapi2.xml":
                    self.send_error(404)
                    return
                elements = "".join(f"<{name}>{text}</{name}>" for name, text in box.page.items())
                body = f'<?xml version="1.0" encoding="utf-8"?><netft>{elements}</netft>'.encode()
                self.send_response(200)
                self.send_header("Content-Type", "text/xml")
                self.send_header("Content-Length", str(len(body)))
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, format: str, *args: object) -> None:
                pass

        return Page

    def _serve(self) -> None:
        while not self._ends.is_set():
            wait_s = IDLE_S if self._client is None else max(0.0, self._due_s() - self.clock())
            # Not through epoll, which counts in whole milliseconds.
            if select.select([self._socket], [], [], min(wait_s, IDLE_S))[0]:
                self._obey(*self._socket.recvfrom(2048))
            if self._client is None or self.clock() < self._due_s():
                continue
            while (client := self._client) is not None and self._sample_s() <= self.clock() and not self._ends.is_set():
                self._send_next(client)

    def _sample_s(self) -> float:
        """Return when the next sample is taken."""
        return self._began_s + self.sent / self.rate_Hz

    def _due_s(self) -> float:
        """Return when there is something to send, after a burst's worth of samples."""
        return self._sample_s() + max(0.0, GRAIN_S - 1 / self.rate_Hz)

    def _obey(self, request: bytes, client: Client) -> None:
        if len(request) != rdt.REQUEST.size or self.faults.take("deaf"):
            return
        header, command, count = rdt.REQUEST.unpack(request)
        if header != rdt.HEADER:
            return
        if command == rdt.START and self.page["comrdte"] != "Disabled":
            self._client, self._left, self._began_s = client, count, self.clock()
            self.sent, self.lost, self._held = 0, [], None
        elif command == rdt.STOP:
            self._client, self.stopped = None, self.stopped + 1
        elif command == rdt.BIAS:
            self._bias = self._last
        elif command == rdt.RESET_LATCH:
            left = self.faults.status & ~rdt.LATCHED
            self.faults.status = 0 if left == rdt.SUMMARY else left

    def _send_next(self, client: Client) -> None:
        faults, sample_s = self.faults, self._sample_s()
        number = (self.first + self.sent) % rdt.WORD
        if not faults.frozen:
            self._ft = int((sample_s - self._power_on_s) * rdt.FT_RATE_Hz) % rdt.WORD
        self._last = tuple(map(mul, self.wrench(sample_s), self._counts_per))
        counts = (
            max(-_COUNT, min(round(count - zero), _COUNT - 1))
            for count, zero in zip(self._last, self._bias, strict=True)
        )
        record = rdt.RECORD.pack(number, self._ft, faults.status, *counts)
        self.sent += 1
        if self.sent == self._left:
            self._client = None
        if faults.silent:
            return
        if faults.take("drop") or (self.loss and self.generator.random() < self.loss):
            self.lost.append(number)
            return
        if self._held is None and faults.take("swap"):
            self._held = record
            return
        self._deliver(record, client)
        if self._held is not None:
            held, self._held = self._held, None
            self._deliver(held, client)

    def _deliver(self, record: bytes, client: Client) -> None:
        faults, sender = self.faults, self._socket
        if faults.take("foreign_port"):
            sender = self._other
        elif faults.take("foreign_address"):
            sender = self._elsewhere = self._elsewhere or _bound("127.0.0.2", self.rdt_port)
        if faults.take("short"):
            record = record[:-1]
        for _ in range(2 if faults.take("duplicate") else 1):
            with suppress(OSError):  # nobody is there any more: datagrams are lost, that is all
                sender.sendto(record, client)


def _bound(host: str, port: int) -> socket.socket:
    opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    opened.bind((host, port))
    return opened
