"""Stages of Micro-Manager, XY and single-axis, through pymmcore-plus: whatever it has an adapter for.

Micro-Manager speaks of no reference and no limit switch, so an axis is referenced when its home run has ended without
an error, or when it is said to know its position by itself, and its limits are those of the :class:`Axis` alone, which
are enforced here: adapters need not. An adapter that waits inside a call makes others of the same adapter wait, stops
too. Speeds are properties whose names depend on the adapter. Tried with the demonstration adapter, and on no device.

pymmcore-plus is installed by the extra `mm`.
"""

import math
import threading
import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from stage_hardware.errors import HardwareError, InterruptedByStopError, LinkError, RefusedError
from stage_hardware.stage import Axis, AxisState, Stage, StageState

HOME_FAILS_WITHIN_S = 0.05
"""How long :meth:`MicroManagerStage.home` waits for an adapter to refuse."""


@dataclass(frozen=True)
class MicroManagerAxis:
    """An axis, in um: the label of its device in Micro-Manager, and which of the two it is if that is an XY stage.

    One that ``knows_its_position`` as soon as it is switched on, as with an absolute encoder, needs no home run.
    """

    axis: Axis
    device: str
    coordinate: Literal["", "x", "y"] = ""
    knows_its_position: bool = False

    def __post_init__(self) -> None:
        """Refuse units that Micro-Manager does not have."""
        if self.axis.unit != "um":
            raise ValueError(f"an axis of Micro-Manager is in um, got {self.axis.unit!r}")

    def nearest(self, target: float) -> float:
        """Return the step nearest to a target that lies within the limits."""
        step = self.axis.resolution
        first, last = math.ceil(self.axis.lo / step - 1e-6), math.floor(self.axis.hi / step + 1e-6)
        return min(max(round(target / step), first), last) * step


class MicroManagerStage(Stage):
    """Axes of one Micro-Manager: loaded from a ``configuration`` file, or a ``core`` that is loaded already.

    ``properties`` are set when connecting and read back, by label and name: ``{("XY", "Velocity"): "2.0"}``. Both axes
    of an XY stage are homed and moved together: one that has no target keeps its last one, or stays where it is.
    ``adapter_paths`` are folders to look for adapters in, beside those of the installed Micro-Manager.
    """

    def __init__(
        self,
        name: str,
        axes: Mapping[str, MicroManagerAxis],
        *,
        configuration: Path | None = None,
        core: Any = None,
        properties: Mapping[tuple[str, str], str] | None = None,
        adapter_paths: Sequence[str] = (),
    ) -> None:
        """Remember what is known before connecting."""
        if (configuration is None) is (core is None):
            raise ValueError("a stage of Micro-Manager takes either a configuration or a core")
        super().__init__(name, {axis_name: axis.axis for axis_name, axis in axes.items()})
        self._axes, self._configuration, self._given_core = dict(axes), configuration, core
        self._properties, self._adapter_paths = dict(properties or {}), tuple(adapter_paths)
        self._devices = list(dict.fromkeys(axis.device for axis in axes.values()))
        self._core: Any = None
        self._lock = threading.RLock()
        self._stops = 0
        self._home_runs: dict[str, _HomeRun] = {}
        self._targets: dict[str, tuple[float, float]] = {}  # of XY stages, since the last stop

    def connect(self) -> None:
        """Load the configuration, see that the devices are stages, and set the properties."""
        with self._lock:
            self.close()
            try:
                with self._told(HardwareError):
                    self._core = self._loaded_core() if self._given_core is None else self._given_core
                    self._see_devices()
                    self._set_properties()
                self.state()
            except HardwareError:
                self.close()
                raise

    def close(self) -> None:
        """Unload what was loaded here; a core that was given is left as it is."""
        core, self._core = self._core, None
        self._home_runs, self._targets = {}, {}
        if core is not None and core is not self._given_core:
            with suppress(RuntimeError):  # a device that is gone
                core.reset()  # with a core that is loaded, the interpreter may abort when it ends

    def home(self, axes: Collection[str]) -> None:
        """Begin the home runs of the devices of some axes, each in a thread, as adapters may wait for its end."""
        stops = self._stops
        devices = list(dict.fromkeys(self._axis(name).device for name in axes))
        with self._lock:
            core = self._connected()
            for device in devices:
                self._refuse_if_stopped(stops)
                self._targets.pop(device, None)
                self._home_runs[device] = run = _HomeRun(core, device, stops)
                run.thread.join(HOME_FAILS_WITHIN_S)
                if run.error is not None:
                    raise RefusedError(
                        self.name, f"it cannot home {device} ({run.error})", "see what its adapter can do"
                    )

    def move_to(self, targets: Mapping[str, float]) -> None:
        """Begin to move, one device after the other."""
        stops = self._stops
        for name, target in targets.items():
            axis = self._axis(name).axis
            if not axis.lo <= target <= axis.hi:
                raise HardwareError(
                    self.name,
                    f"{name} cannot go to {target:g} {axis.unit}, its limits are {axis.lo:g}..{axis.hi:g}",
                    "stay within them",
                )
        with self._lock:
            core = self._connected()
            for name in targets:
                if not self._is_referenced(self._axes[name]):
                    raise HardwareError(self.name, f"{name} is not referenced", "home it first")
            for device in self._devices:
                there = {
                    axis.coordinate: axis.nearest(targets[name])
                    for name, axis in self._axes.items()
                    if name in targets and axis.device == device
                }
                if there:
                    self._refuse_if_stopped(stops)
                    self._begin(core, device, there)
                    if stops != self._stops:  # one that came while the adapter was busy with this
                        self._stop_all(core)
                        self._refuse_if_stopped(stops)

    def stop(self) -> None:
        """Stop all devices; one that cannot be stopped keeps no other one from it."""
        core = self._connected()
        self._stops += 1
        self._stop_all(core)

    def state(self) -> StageState:
        """Ask whether the devices are busy, then where they are: one that is not has the position that it will keep."""
        with self._lock, self._told(HardwareError):
            core = self._connected()
            busy = {device: core.deviceBusy(device) or self._is_homing(device) for device in self._devices}
            time_ns = time.monotonic_ns()  # of the oldest of the positions
            positions = {device: self._positions(core, device) for device in self._devices}
            faults = [
                f"homing {device} has failed ({run.error})"
                for device, run in self._home_runs.items()
                if run.error is not None
            ]
            return StageState(
                time_ns,
                {
                    name: AxisState(
                        positions[axis.device][axis.coordinate], busy[axis.device], self._is_referenced(axis)
                    )
                    for name, axis in self._axes.items()
                },
                "; ".join(faults) or None,
            )

    def _stop_all(self, core: Any) -> None:
        self._targets, faults = {}, []
        for device in self._devices:
            try:
                core.stop(device)
            except (RuntimeError, OSError) as error:
                faults.append(f"{device} ({error})")
        if faults:
            raise HardwareError(self.name, f"it cannot stop {', '.join(faults)}", "see what the adapter can do")

    def _loaded_core(self) -> Any:
        try:
            from pymmcore_plus import CMMCorePlus
        except ImportError:
            raise HardwareError(
                self.name, "pymmcore-plus is not installed", "pip install 'neurorobo-stage-hardware[mm]'"
            ) from None
        core = CMMCorePlus(adapter_paths=self._adapter_paths)
        try:
            core.loadSystemConfiguration(str(self._configuration))
        except (RuntimeError, OSError):
            core.reset()
            raise
        return core

    def _see_devices(self) -> None:
        for name, axis in self._axes.items():
            wanted = "XYStageDevice" if axis.coordinate else "StageDevice"
            there = self._core.getDeviceType(axis.device).name
            if there != wanted:
                raise HardwareError(
                    self.name,
                    f"{axis.device}, the device of {name}, is of type {there}, not {wanted}",
                    "see to label and coordinate",
                )

    def _set_properties(self) -> None:
        for (device, name), value in self._properties.items():
            self._core.setProperty(device, name, value)
            there = self._core.getProperty(device, name)
            if not _is_same(there, value):
                raise HardwareError(
                    self.name, f"{name} of {device} is {there} after it was set to {value}", "see what it allows"
                )

    def _begin(self, core: Any, device: str, there: Mapping[Literal["", "x", "y"], float]) -> None:
        with self._told(RefusedError):
            if "" in there:
                core.setPosition(device, there[""])
                return
            here = self._targets.get(device) or tuple(core.getXYPosition(device))
            self._targets[device] = (there.get("x", here[0]), there.get("y", here[1]))
            core.setXYPosition(device, *self._targets[device])

    def _positions(self, core: Any, device: str) -> dict[str, float]:
        if any(axis.coordinate for axis in self._axes.values() if axis.device == device):
            return dict(zip("xy", core.getXYPosition(device), strict=True))
        return {"": core.getPosition(device)}

    def _is_homing(self, device: str) -> bool:
        run = self._home_runs.get(device)
        return run is not None and run.thread.is_alive()

    def _is_referenced(self, axis: MicroManagerAxis) -> bool:
        """A home run counts if it has ended, without an error and without a stop."""
        run = self._home_runs.get(axis.device)
        if run is None:
            return axis.knows_its_position
        if not run.counts and run.error is None and not run.thread.is_alive():
            run.counts = run.stops == self._stops and not self._connected().deviceBusy(axis.device)
        return run.counts or axis.knows_its_position

    def _axis(self, name: str) -> MicroManagerAxis:
        if name not in self._axes:
            raise HardwareError(self.name, f"it has no axis {name}", f"there are: {', '.join(self._axes)}")
        return self._axes[name]

    def _refuse_if_stopped(self, stops: int) -> None:
        if stops != self._stops:
            raise InterruptedByStopError(self.name, "a stop came first", "look at the state before the next command")

    def _connected(self) -> Any:
        if self._core is None:
            raise LinkError(self.name, "it is not connected", "connect first")
        return self._core

    @contextmanager
    def _told(self, kind: type[HardwareError]) -> Iterator[None]:
        """Tell what Micro-Manager says, which has one kind of error for all."""
        try:
            yield
        except (RuntimeError, OSError, ValueError) as error:
            raise kind(
                self.name, f"Micro-Manager says {error}", "see to the device, and to its configuration"
            ) from error


class _HomeRun:
    """A home run that was begun after so many stops, and what became of it."""

    def __init__(self, core: Any, device: str, stops: int) -> None:
        self.stops, self.counts = stops, False
        self.error: Exception | None = None
        self.thread = threading.Thread(target=self._run, args=(core, device), name=f"home {device}", daemon=True)
        self.thread.start()

    def _run(self, core: Any, device: str) -> None:
        try:
            core.home(device)
        except (RuntimeError, OSError) as error:
            self.error = error


def _is_same(there: str, value: str) -> bool:
    try:
        return math.isclose(float(there), float(value), rel_tol=0.01)
    except ValueError:
        return there == value
