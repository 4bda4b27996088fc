"""The controller's end of a line: a pseudo-terminal or a TCP port behind which an emulator answers."""

import os
import selectors
import socket
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from typing import Self

from stage_hardware.emulators.faults import WireFaults

BITS_PER_BYTE = 10
"""Eight of them data: a start and a stop bit."""

Answer = Callable[[bytes], Iterable[bytes]]
"""What an emulator does with bytes that arrive, in pieces of any size: it returns replies, each with its end."""


class Wire(ABC):
    """A line to one client at a time, served by a thread between :meth:`start` and :meth:`close`.

    Bytes take their time in both directions: 10 bits each at ``baud``, or none if that is 0. ``processing_s`` passes
    before a reply begins. Faults are set on ``faults`` at any time. ``later`` is asked about every 20 ms for replies
    that nothing on the line calls forth, such as those that wait for the end of a motion.
    """

    def __init__(self, answer: Answer, *, baud: int = 0, processing_s: float = 0.0) -> None:
        """Prepare it; :meth:`start` opens it."""
        self.answer, self.baud, self.processing_s = answer, baud, processing_s
        self.faults = WireFaults()
        self.later: Callable[[], Iterable[bytes]] = tuple
        self._thread: threading.Thread | None = None
        self._ends = threading.Event()

    @property
    @abstractmethod
    def url(self) -> str:
        """What a client opens."""

    def start(self) -> Self:
        """Open the line and begin to answer."""
        self._open()
        self._thread = threading.Thread(target=self._serve, name=f"emulator {self.url}", daemon=True)
        self._thread.start()
        return self

    def close(self) -> None:
        """End; safe to call twice."""
        self._ends.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        self._shut()

    def __enter__(self) -> Self:
        """Start."""
        return self.start()

    def __exit__(self, *_: object) -> None:
        """Close."""
        self.close()

    @abstractmethod
    def _open(self) -> None: ...

    @abstractmethod
    def _shut(self) -> None: ...

    @abstractmethod
    def _receive(self, wait_s: float) -> bytes:
        """Return what has arrived, after at most so long."""

    @abstractmethod
    def _send(self, data: bytes) -> None: ...

    def _serve(self) -> None:
        while not self._ends.is_set():
            if self.faults.hang_up:
                self._shut()
                return
            came = self._receive(0.02)
            if self.faults.deaf:
                continue
            self._take_time(came)
            for reply in self.answer(came) if came else self.later():
                self._reply(reply)

    def _reply(self, reply: bytes) -> None:
        time.sleep(self.processing_s)
        if self.faults.take("no_reply"):
            return
        if self.faults.take("late_reply"):
            self._ends.wait(self.faults.late_s)
        if self.faults.take("garbled_reply"):
            reply = bytes([reply[0] ^ 0x40]) + reply[1:]  # a digit becomes a letter, never another digit
        if self.faults.take("wrong_terminator"):
            reply = reply.rstrip(b"\r\n") + b";"
        if self.faults.take("split_reply"):
            half = len(reply) // 2
            self._paced(reply[:half])
            time.sleep(0.03)
            reply = reply[half:]
        self._paced(reply)

    def _paced(self, data: bytes) -> None:
        self._take_time(data)
        self._send(data)

    def _take_time(self, data: bytes) -> None:
        if self.baud:
            time.sleep(len(data) * BITS_PER_BYTE / self.baud)


class PseudoTerminal(Wire):
    """A line that a client opens as a serial port; there are none on Windows."""

    def _open(self) -> None:
        import pty
        import tty

        self._master, self._slave = pty.openpty()  # held open, or the master would see the end between two clients
        tty.setraw(self._master)
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self._path, self._is_open = os.ttyname(self._slave), True
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._master, selectors.EVENT_READ)

    def _shut(self) -> None:
        if getattr(self, "_is_open", False):
            self._is_open = False
            self._selector.close()
            os.close(self._slave)
            os.close(self._master)

    @property
    def url(self) -> str:
        """The path of the port."""
        return self._path

    @property
    def settings(self) -> tuple[int, bool]:
        """The speed in baud and whether there is hardware flow control, as the client has set them."""
        import termios

        _, _, flags, _, _, speed, _ = termios.tcgetattr(self._master)
        rates = {
            getattr(termios, name): int(name[1:]) for name in dir(termios) if name[0] == "B" and name[1:].isdigit()
        }
        return rates[speed], bool(flags & termios.CRTSCTS)

    def _receive(self, wait_s: float) -> bytes:
        if not self._selector.select(wait_s):
            return b""
        try:
            return os.read(self._master, 4096)
        except OSError:
            return b""

    def _send(self, data: bytes) -> None:
        while data and self._is_open:
            try:
                data = data[os.write(self._master, data) :]
            except BlockingIOError:  # nobody reads
                if self._ends.wait(0.01):
                    return


class TcpPort(Wire):
    """A line that a client opens over TCP, as ``socket://127.0.0.1:port``."""

    def __init__(self, answer: Answer, *, port: int = 0, baud: int = 0, processing_s: float = 0.0) -> None:
        """Prepare it; port 0 stands for any that is free."""
        super().__init__(answer, baud=baud, processing_s=processing_s)
        self.port = port
        self._client: socket.socket | None = None

    def _open(self) -> None:
        self._server = socket.create_server(("127.0.0.1", self.port))
        self._server.setblocking(False)
        self.port = self._server.getsockname()[1]

    def _shut(self) -> None:
        if self._client is not None:
            self._client.close()
            self._client = None
        self._server.close()

    @property
    def url(self) -> str:
        """What a client opens."""
        return f"socket://127.0.0.1:{self.port}"

    def _receive(self, wait_s: float) -> bytes:
        waiting = self._server if self._client is None else self._client
        with selectors.DefaultSelector() as selector:
            selector.register(waiting, selectors.EVENT_READ)
            if not selector.select(wait_s):
                return b""
        if self._client is None:
            self._client, _ = self._server.accept()
            self._client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            return b""
        try:
            came = self._client.recv(4096)
        except OSError:
            came = b""
        if not came:
            self._client.close()
            self._client = None
        return came

    def _send(self, data: bytes) -> None:
        if self._client is not None:
            try:
                self._client.sendall(data)
            except OSError:
                self._client = None
