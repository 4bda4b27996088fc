"""A device of PIPython, PI's own library, as a stage: for USB, daisy chains, and controllers behind PI's own drivers.

PIPython is installed by the extra `pi`; its licence is PI's and not an open one. It carries the same commands as
:mod:`stage_hardware.drivers.pi_gcs` sends, in its own way: it waits for answers with one processor core busy, and takes
a lost connection for silence until something is written. Tried against the emulator through its serial port and its
socket, and on no device; what PI's compiled library does with a stop while an answer is awaited is not known.
"""

import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Any, Protocol

from stage_hardware.drivers.pi_gcs import C_863, GcsStage, PiAxis, StatusBits
from stage_hardware.errors import HardwareError, InterruptedByStopError, LinkError, ReplyError, ReplyTimeoutError
from stage_hardware.links.gcs_line import STOP_ALL, GcsLine
from stage_hardware.links.serial_link import STOP_WAITS_S

COM_TIMEOUT = -7
"""PIPython's code for an answer that did not come."""


class Device(Protocol):
    """What is used of a connected ``GCSDevice`` or ``GCS2Device``."""

    @property
    def messages(self) -> Any:
        """What sends and reads."""

    def __exit__(self, *_: object) -> None:
        """Close it, and take what it has registered back."""


class PipythonLine(GcsLine):
    """The messages of a device; a stop goes past them, straight to the gateway below."""

    def __init__(self, name: str, open_device: Callable[[], Device], timeout_s: float) -> None:
        """Name it; :meth:`open` opens it."""
        self._name, self._open_device, self._timeout_s = name, open_device, timeout_s
        self._device: Device | None = None
        self._stops, self._is_behind = 0, False
        self._writes = threading.Lock()

    @property
    def stops(self) -> int:
        """How many stops there were."""
        return self._stops

    def open(self) -> None:
        """Open the device; its own question for errors after each call is switched off, as the stage asks."""
        try:
            with self._told():
                self._device = self._open_device()
                self._messages.errcheck = False
                self._messages.timeout = 1000 * self._timeout_s
        except ImportError:
            raise HardwareError(
                self._name, "pipython is not installed", "pip install 'neurorobo-stage-hardware[pi]'"
            ) from None

    def close(self) -> None:
        """Close the device, whether or not it still answers."""
        device, self._device = self._device, None
        if device is not None:
            with suppress(HardwareError), self._told():
                device.__exit__(None, None, None)

    def ask(self, query: str) -> list[str]:
        """Return the lines of an answer."""
        with self._told():
            if self._is_behind:
                time.sleep(self._timeout_s)
                self._messages.interface.flush()
                self._is_behind = False
            return [line.strip() for line in self._messages.read(query).strip("\n").split("\n")]

    def order(self, command: str, stops: int) -> str:
        """Send an order and then the question for its error."""
        with self._told(), self._writes:
            if stops != self._stops:
                raise InterruptedByStopError(
                    self._name, "a stop came first", "look at the state before the next command"
                )
            self._messages.send(command)
        return self.ask("ERR?")[0]

    def stop_all(self) -> None:
        """Write the one byte that stops; an answer that is awaited goes on being awaited."""
        self._stops += 1
        has_lock = self._writes.acquire(timeout=STOP_WAITS_S)
        try:
            with self._told():
                self._messages.interface.send(STOP_ALL)
        finally:
            if has_lock:
                self._writes.release()

    def distrust(self) -> None:
        """Let the next query wait for what still comes."""
        self._is_behind = True

    @property
    def _messages(self) -> Any:
        if self._device is None:
            raise LinkError(self._name, "it is not connected", "connect first")
        return self._device.messages

    @contextmanager
    def _told(self) -> Iterator[None]:
        """Tell what PIPython raises in terms of the device."""
        try:
            yield
        except OSError as error:
            raise LinkError(
                self._name, f"the line is gone ({error})", "see to cable and power, then connect again"
            ) from error
        except (HardwareError, ImportError):
            raise
        except Exception as error:  # a GCSError, or what PIPython itself makes of a line feed in the wrong place
            self.distrust()
            if getattr(error, "val", None) == COM_TIMEOUT:
                raise ReplyTimeoutError(
                    self._name,
                    f"no reply within {self._timeout_s:g} s",
                    "see that it is switched on, and that baud rate and cable are right",
                ) from error
            raise ReplyError(self._name, f"PIPython says {error}", "see to baud rate and cable") from error


class PipythonStage(GcsStage):
    """A stage of PIPython, which ``open_device`` returns connected; one that speaks GCS 2.0.

    That may be a ``GCSDevice`` on which ``ConnectUSB`` or ``ConnectDaisyChainDevice`` was called; for serial and TCP
    ports there is :func:`open_device`.
    """

    def __init__(
        self,
        name: str,
        open_device: Callable[[], Device],
        axes: Mapping[str, PiAxis],
        *,
        timeout_s: float = 0.5,
        identity: str = "",
        status_bits: StatusBits | None = C_863,
    ) -> None:
        """Remember what is known before connecting."""
        line = PipythonLine(name, open_device, timeout_s)
        super().__init__(name, axes, line, identity=identity, status_bits=status_bits)


def open_device(url: str, baud: int = 115200) -> Device:
    """Return a device at a serial port or, as ``socket://192.168.0.1:50000``, at a TCP port; without PI's drivers."""
    from pipython import GCS2Device
    from pipython.pidevice.interfaces.piserial import PISerial
    from pipython.pidevice.interfaces.pisocket import PISocket

    if url.startswith("socket://"):
        host, _, port = url.removeprefix("socket://").rpartition(":")
        gateway: PISocket | PISerial = PISocket(host, int(port))
    else:
        gateway = PISerial(url, baud)
    device: Device = GCS2Device(gateway=gateway)
    return device
