"""A serial line, or a TCP connection that stands for one: lines out, lines in, and a way past them for a stop."""

import os
import select
import socket
import sys
import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from stage_hardware.errors import HardwareError, InterruptedByStopError, LinkError, ReplyTimeoutError

if TYPE_CHECKING:
    import serial

POLL_S = 0.005
"""How long a read waits at most before it looks whether a stop wants the line."""

SLEEPS_S = 0.001
"""How long a read sleeps at a port that cannot be waited for, as those of Windows."""

AT_ONCE_BYTES = 4096
"""How much a read takes at most of what has come."""

GONE = OSError, ValueError, TypeError, AttributeError
"""What a port raises that is lost; all but the first if another thread closes it meanwhile."""

FILES = ("serial.serialposix.Serial", "serial.urlhandler.protocol_socket.Serial")
"""The ports of pyserial that are, on systems other than Windows."""

STOP_WAITS_S = 0.05
"""How long a stop lets a transaction end by itself; then it writes all the same."""


class SerialLink:
    """Transactions with a controller, one at a time, and stops that go first.

    After a reply that did not come, what comes late is thrown away before the next command goes out, as it would be
    taken for the answer to that one. Text is ASCII; terminators are the caller's to name. Methods raise
    :class:`LinkError` if the line is gone, :class:`ReplyTimeoutError` after ``timeout_s``, and
    :class:`InterruptedByStopError` if a stop came between.

    ``stops`` counts the stops. A command that was decided on before a stop must not go out after it: one that is given
    the count as it was then is refused if there has been another.

    ``unasked`` is given the text that is thrown away, for controllers that report errors without being asked; it is
    called in the midst of a transaction and must not begin one.

    A caller that ``knows_replies``, as it can ask something whose reply is like no other, throws late ones away itself:
    no command waits for them, and only whole lines are thrown away here.
    """

    def __init__(
        self,
        device: str,
        url: str,
        *,
        baud: int,
        ends: bytes,
        reply_ends: bytes,
        hardware_flow_control: bool = False,
        timeout_s: float = 0.5,
        unasked: Callable[[str], None] | None = None,
        knows_replies: bool = False,
    ) -> None:
        """Name the line: a port such as `/dev/ttyUSB0` or `COM3`, or a URL such as `socket://host:port`."""
        self.device, self.url, self.baud, self.timeout_s = device, url, baud, timeout_s
        self._ends, self._reply_ends, self._flow_control = ends, reply_ends, hardware_flow_control
        self._unasked, self._knows_replies = unasked, knows_replies
        self._port: serial.Serial | None = None
        self._is_file = False
        self._lock = threading.Lock()
        self._stopping = threading.Event()
        self._received = bytearray()
        self._is_behind = False
        self._owed: int | None = 0  # lines that are to come yet, if that is known
        self.stops = 0

    def open(self) -> None:
        """Open the line; a HardwareError if it cannot be."""
        try:
            import serial
        except ImportError:
            raise HardwareError(
                self.device, "pyserial is not installed", "pip install 'neurorobo-stage-hardware[hardware]'"
            ) from None
        try:
            port = serial.serial_for_url(self.url, do_not_open=True)
            port.baudrate, port.timeout, port.write_timeout = self.baud, 0, self.timeout_s
            port.rtscts = self._flow_control
            port.exclusive = True  # two programs on one line would take each other's answers
            port.open()
        except (OSError, ValueError, NotImplementedError) as error:
            raise LinkError(
                self.device, f"{self.url} cannot be opened ({error})", "see that it is connected, and not in use"
            ) from error
        connection = getattr(port, "_socket", None)  # of a TCP port
        if connection is not None:  # or a stop would wait until what went before it was acknowledged, some 40 ms
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._port, self._received, self._is_behind, self._owed = port, bytearray(), False, 0
        self._is_file = _is_file(port)

    def close(self) -> None:
        """Close the line; safe to call at any time, and twice.

        Lines that are known to come yet are waited for, as whoever opens it next would take them for answers.
        """
        if self._port is not None and self._owed and self._lock.acquire(timeout=STOP_WAITS_S):
            try:
                self._catch_up()
            except HardwareError:
                pass
            finally:
                self._lock.release()
        port, self._port = self._port, None
        if port is not None:
            has_lock = self._lock.acquire(timeout=STOP_WAITS_S)  # who waits for an answer sees that, and leaves
            try:
                connection = getattr(port, "_socket", None)  # which pyserial leaves open if its other end is gone
                port.close()
                if connection is not None:
                    connection.close()
            finally:
                if has_lock:
                    self._lock.release()

    def send(self, command: str, *, stops: int | None = None) -> None:
        """Send a command that has no reply."""
        with self._lock:
            self._refuse_if_stopping(stops)
            self._catch_up()
            self._write(command.encode("ascii") + self._ends)

    def ask(self, command: str, timeout_s: float | None = None, *, stops: int | None = None) -> str:
        """Send a command and return the line that answers it, without its end."""
        return self.ask_all(command.encode("ascii") + self._ends, timeout_s=timeout_s, stops=stops)[0][0]

    def ask_all(
        self,
        command: bytes,
        answers: int = 1,
        timeout_s: float | None = None,
        *,
        stops: int | None = None,
        goes_on: Callable[[str], bool] = lambda line: False,
    ) -> list[list[str]]:
        """Send bytes as they are, such as several queries at once, and return so many answers, the lines of each.

        An answer has one line more for each that ``goes_on``. No stop comes between two lines without being noticed.
        """
        timeout_s = self.timeout_s if timeout_s is None else timeout_s
        with self._lock:
            self._refuse_if_stopping(stops)
            self._catch_up()
            told, began = list[list[str]](), self.stops
            try:
                self._write(command)
                for _ in range(answers):
                    told.append(answer := list[str]())
                    while not answer or goes_on(answer[-1]):
                        if self.stops != began:
                            raise self._interrupted()
                        answer.append(self._line(command, timeout_s))
            except BaseException:  # Ctrl-C too: what still comes must not answer the next command
                if answers > 1 or not self._is_behind:
                    self.distrust()
                raise
            return told

    def read_line(self, timeout_s: float | None = None) -> str:
        """Return a further line of an answer that has several."""
        with self._lock:
            return self._line(b"the lines before", self.timeout_s if timeout_s is None else timeout_s)

    @property
    def is_behind(self) -> bool:
        """Whether an answer did not come, or made no sense, since the last command."""
        return self._is_behind

    def distrust(self) -> None:
        """Throw away what still comes before the next command goes out: the last reply made no sense."""
        self._is_behind, self._owed = True, None

    def urgent(self, data: bytes, *, is_answered: bool = True, lines: int | None = None) -> None:
        """Write a stop: a transaction that is under way is given up, and never waited for longer than 50 ms.

        Replies to it, and what is left of the other one, are thrown away before the next command; a stop that has no
        reply, and gave up no transaction, needs no waiting for them. If it is known how many ``lines`` answer it, and
        what it gave up is answered by one, that takes until they have come.
        """
        self.stops += 1
        self._stopping.set()
        has_lock = self._lock.acquire(timeout=STOP_WAITS_S)
        try:
            self._write(data)
            self._is_behind = self._is_behind or is_answered or not has_lock
            known = has_lock and lines is not None and self._owed is not None
            self._owed = (self._owed or 0) + (lines or 0) if known else None
        finally:
            self._stopping.clear()
            if has_lock:
                self._lock.release()

    def _refuse_if_stopping(self, stops: int | None = None) -> None:
        if self._stopping.is_set() or stops not in (None, self.stops):
            raise self._interrupted()

    def _catch_up(self) -> None:
        """Throw away what belongs to no command: what has come by now, and after a missing reply what comes late."""
        thrown = bytearray()
        if not self._knows_replies:
            thrown, self._received = self._received, thrown
        if not (self._receive() or self._received or thrown or self._is_behind) and self._owed == 0:
            return  # as nearly always, and each command waits for it
        wait_until = time.monotonic() + (self.timeout_s if self._is_behind and not self._knows_replies else 0.0)
        while self._receive(waits=(waits := not self._has_all() and time.monotonic() < wait_until)) or waits:
            self._refuse_if_stopping()
        lines, end, rest = self._received.rpartition(self._reply_ends)
        thrown += lines + end if self._knows_replies else self._received
        self._received = rest if self._knows_replies else bytearray()
        if thrown and self._unasked:
            self._unasked(thrown.decode("ascii", errors="replace"))
        self._is_behind, self._owed = False, 0

    def _has_all(self) -> bool:
        return self._owed is not None and self._received.count(self._reply_ends) >= self._owed

    def _line(self, command: bytes, timeout_s: float) -> str:
        deadline = time.monotonic() + timeout_s
        while (end := self._received.find(self._reply_ends)) < 0:
            if self._stopping.is_set():
                self._is_behind, self._owed = True, 1
                raise self._interrupted()
            if time.monotonic() > deadline:
                self._is_behind, self._owed = True, None
                raise ReplyTimeoutError(
                    self.device,
                    f"no reply to {command.decode('ascii').rstrip()!r} within {timeout_s:g} s",
                    "see that it is switched on, and that baud rate and cable are right",
                )
            self._receive(waits=True)
        line = bytes(self._received[:end])
        del self._received[: end + len(self._reply_ends)]
        return line.decode("ascii", errors="replace")

    def _receive(self, *, waits: bool = False) -> bool:
        """Add what has come to what was received, waiting for a moment if nothing has; return whether something had."""
        port = self._opened()
        try:
            received = self._read(port, POLL_S if waits else 0)
        except GONE as error:
            raise self._lost(error) from error
        self._received += received
        return bool(received)

    def _read(self, port: "serial.Serial", within_s: float) -> bytes:
        if self._is_file:  # past pyserial, whose part in it takes longer than the read itself
            descriptor = port.fileno()
            if not select.select([descriptor], [], [], within_s)[0]:
                return b""
            try:
                received = os.read(descriptor, AT_ONCE_BYTES)
            except BlockingIOError:  # it had not come after all
                return b""
            if not received:
                raise OSError("its other end was closed")
            return received
        received = port.read(AT_ONCE_BYTES)
        if not received and within_s:
            time.sleep(SLEEPS_S)
        return received

    def _write(self, data: bytes) -> None:
        port = self._opened()
        try:
            if rest := data[self._written_at_once(port, data) :]:
                port.write(rest)
        except GONE as error:
            raise self._lost(error) from error

    def _written_at_once(self, port: "serial.Serial", data: bytes) -> int:
        """Write what can be without waiting, as nearly always all can, and return how many bytes.

        With flow control by hardware it is pyserial that waits: what the other end does not take would pile up, and a
        stop would come after it.
        """
        if not self._is_file or self._flow_control:
            return 0
        try:
            return os.write(port.fileno(), data)
        except BlockingIOError:
            return 0

    def _opened(self) -> "serial.Serial":
        if self._port is None:
            raise LinkError(self.device, "it is not connected", "connect first")
        return self._port

    def _lost(self, error: Exception) -> LinkError:
        return LinkError(self.device, f"{self.url} is gone ({error})", "see to cable and power, then connect again")

    def _interrupted(self) -> InterruptedByStopError:
        return InterruptedByStopError(self.device, "a stop came first", "look at the state before the next command")


def _is_file(port: "serial.Serial") -> bool:
    """Return whether a port can be waited for, read and written as files are: a serial port or a TCP connection."""
    kind = type(port)
    return sys.platform != "win32" and f"{kind.__module__}.{kind.__name__}" in FILES
