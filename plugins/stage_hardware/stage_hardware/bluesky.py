"""Axes of any stage as devices of Bluesky, which is not imported: its protocols are structural.

See https://blueskyproject.io/bluesky/main/hardware.html for the methods, and ophyd-async's EPICS motor for the time
that a motion may take.
"""

import threading
import time
from collections.abc import Callable
from typing import Any

from stage_hardware.errors import HardwareError, InterruptedByStopError
from stage_hardware.stage import Stage, StageState

MARGIN_S = 10.0
"""What a motion may take longer than speed and acceleration explain."""


class MotionStatus:
    """How a motion goes: ``done`` with ``success``, or with an :meth:`exception`."""

    def __init__(self) -> None:
        """Begin."""
        self._ended, self._lock = threading.Event(), threading.Lock()
        self._error: BaseException | None = None
        self._callbacks: list[Callable[[MotionStatus], None]] = []

    @property
    def done(self) -> bool:
        """Whether it has ended."""
        return self._ended.is_set()

    @property
    def success(self) -> bool:
        """Whether it has ended where it should."""
        return self.done and self._error is None

    def add_callback(self, callback: Callable[["MotionStatus"], None]) -> None:
        """Have a function called with this at the end, or at once if it has ended."""
        with self._lock:
            if not self.done:
                self._callbacks.append(callback)
                return
        callback(self)

    def exception(self, timeout: float | None = 0.0) -> BaseException | None:
        """Return why it failed, or None if it did not, after waiting for its end; a TimeoutError if that is not yet."""
        if not self._ended.wait(timeout):
            raise TimeoutError(f"the motion has not ended within {timeout:g} s")
        return self._error

    def wait(self, timeout: float | None = None) -> None:
        """Wait for the end, and raise why it failed; a TimeoutError if that is not yet."""
        error = self.exception(timeout)
        if error is not None:
            raise error

    def end(self, error: BaseException | None = None) -> None:
        """End, and call all callbacks."""
        with self._lock:
            self._error = error
            self._ended.set()
            callbacks, self._callbacks = self._callbacks, []
        for callback in callbacks:
            callback(self)


class _Turns:
    """What the axes of one stage share: who may move, if not all at once, and how often and how they were stopped."""

    def __init__(self) -> None:
        self.lock, self.stops, self.stop_is_success = threading.Lock(), 0, False


class BlueskyAxis:
    """An axis of a connected and homed stage that Bluesky can read, move and stop.

    A motion is followed in a thread of its own, every ``poll_s``. :meth:`stop` stops all axes of the stage, as that is
    what :meth:`stage_hardware.stage.Stage.stop` does.
    """

    parent = None

    def __init__(self, stage: Stage, axis: str, *, poll_s: float = 0.05, turns: _Turns | None = None) -> None:
        """Name the axis; :func:`bluesky_axes` makes those of a stage."""
        self.stage, self.axis, self.poll_s = stage, axis, poll_s
        self.name = f"{stage.name}_{axis}"
        self._turns = turns or _Turns()
        self._setpoint: float | None = None

    @property
    def hints(self) -> dict[str, list[str]]:
        """What plots and tables show."""
        return {"fields": [self.name]}

    @property
    def position(self) -> float:
        """Where it is, in the unit of the axis."""
        return self.stage.state().axes[self.axis].position

    def set(self, value: float) -> MotionStatus:
        """Begin to move to a position; the status fails with a HardwareError, or a TimeoutError."""
        status, stops = MotionStatus(), self._turns.stops
        self._setpoint = value = float(value)
        threading.Thread(
            target=self._follow, args=(value, status, stops), name=f"move {self.name}", daemon=True
        ).start()
        return status

    def stop(self, success: bool = False) -> None:
        """Stop all axes of the stage; motions that are under way then end with success, or fail."""
        self._turns.stop_is_success = success
        self._turns.stops += 1
        self.stage.stop()

    def locate(self) -> dict[str, float]:
        """Return where it was sent, and where it is."""
        readback = self.position
        return {"setpoint": readback if self._setpoint is None else self._setpoint, "readback": readback}

    def read(self) -> dict[str, dict[str, Any]]:
        """Return its position, and when that was, in seconds of the epoch."""
        state = self.stage.state()
        timestamp = time.time() - state.age_ns(time.monotonic_ns()) / 1e9
        return {self.name: {"value": state.axes[self.axis].position, "timestamp": timestamp}}

    def describe(self) -> dict[str, dict[str, Any]]:
        """Return unit, limits and resolution of what :meth:`read` returns."""
        axis = self.stage.axes[self.axis]
        return {
            self.name: {
                "source": f"neurorobo:{self.stage.name}:{self.axis}",
                "dtype": "number",
                "shape": [],
                "units": axis.unit,
                "limits": {"control": {"low": axis.lo, "high": axis.hi}},
            }
        }

    def read_configuration(self) -> dict[str, dict[str, Any]]:
        """Return what is known of the axis before it moves."""
        axis, now = self.stage.axes[self.axis], time.time()
        return {
            f"{self.name}_{key}": {"value": getattr(axis, key), "timestamp": now}
            for key in ("resolution", "speed", "acceleration")
        }

    def describe_configuration(self) -> dict[str, dict[str, Any]]:
        """Return units of what :meth:`read_configuration` returns."""
        unit = self.stage.axes[self.axis].unit
        units = {"resolution": unit, "speed": f"{unit}/s", "acceleration": f"{unit}/s^2"}
        source = f"neurorobo:{self.stage.name}:{self.axis}"
        return {
            f"{self.name}_{key}": {"source": source, "dtype": "number", "shape": [], "units": units[key]}
            for key in units
        }

    def _follow(self, value: float, status: MotionStatus, stops: int) -> None:
        try:
            if self.stage.begins_while_moving:
                self._move(value, stops)
            else:
                with self._turns.lock:
                    self._move(value, stops)
        except _StoppedError:
            failed = HardwareError(self.stage.name, f"axis {self.axis} was stopped", "set it again")
            status.end(None if self._turns.stop_is_success else failed)
        except BaseException as error:  # whatever it is, who waits for the status must hear of it
            status.end(error)
        else:
            status.end()

    def _move(self, value: float, stops: int) -> None:
        self._refuse_if_stopped(stops)
        axis = self.stage.axes[self.axis]
        way = abs(value - self._state().axes[self.axis].position)
        deadline = time.monotonic() + way / axis.speed + 2 * axis.speed / axis.acceleration + MARGIN_S
        try:
            self.stage.move_to({self.axis: value})
        except InterruptedByStopError:
            self._refuse_if_stopped(stops)
            raise
        if self._turns.stops != stops:  # by a stop that was not heard, as it came just before the motion
            self.stage.stop()
        while True:
            state = self._state()
            now = state.axes[self.axis]
            if not now.moving:
                break
            if time.monotonic() > deadline:
                self.stage.stop()
                raise TimeoutError(f"{self.name} still moves at {now.position:g} {axis.unit}, and was stopped")
            time.sleep(self.poll_s)
        self._refuse_if_stopped(stops)
        if abs(now.position - value) > axis.resolution:
            raise HardwareError(
                self.stage.name,
                f"axis {self.axis} came to rest at {now.position:g} {axis.unit}, not {value:g}"
                + (f" ({state.fault})" if state.fault else ""),
                "see what is in its way",
            )

    def _state(self) -> StageState:
        """Return the state of the stage, also when a stop interrupts the question."""
        try:
            return self.stage.state()
        except InterruptedByStopError:
            return self.stage.state()

    def _refuse_if_stopped(self, stops: int) -> None:
        if self._turns.stops != stops:
            raise _StoppedError


class _StoppedError(Exception):
    """The motion was stopped by :meth:`BlueskyAxis.stop`."""


def bluesky_axes(stage: Stage, *, poll_s: float = 0.05) -> dict[str, BlueskyAxis]:
    """Return all axes of a stage as devices of Bluesky, named after stage and axis.

    Where a controller cannot begin a motion while another axis moves, they take turns.
    """
    turns = _Turns()
    return {axis: BlueskyAxis(stage, axis, poll_s=poll_s, turns=turns) for axis in stage.axes}
