"""A stage without a wire: the contract, kept by mechanisms in this process."""

import threading
import time
from collections.abc import Collection, Mapping

from stage_hardware.emulators.mechanism import Clock, Mechanism
from stage_hardware.errors import LinkError, RefusedError, ReplyTimeoutError
from stage_hardware.stage import Axis, AxisState, Stage, StageState


class MockStage(Stage):
    """A stage whose axes move as :class:`stage_hardware.emulators.mechanism.Mechanism`, from any thread.

    ``mechanisms`` are its axes, in their units, with switches ``beyond`` their limits. Faults: ``silent`` (replies that
    do not come), ``refusals`` (how many of the next commands are refused), ``unplugged``, :meth:`power_cycle`, and what
    mechanisms can do by themselves. It starts unreferenced, each axis at ``positions`` or at a tenth of its travel.
    """

    def __init__(
        self,
        name: str,
        axes: Mapping[str, Axis],
        *,
        positions: Mapping[str, float] | None = None,
        beyond: float = 1.0,
        clock: Clock = time.monotonic,
    ) -> None:
        """Put axes at physical positions."""
        super().__init__(name, axes)
        self.mechanisms = {
            key: Mechanism(
                min(axis.lo, 0.0) - beyond,
                max(axis.hi, 0.0) + beyond,
                position=(positions or {}).get(key, axis.lo + (axis.hi - axis.lo) / 10),
                start_speed=0.0,
                speed=axis.speed,
                acceleration=axis.acceleration,
                clock=clock,
            )
            for key, axis in axes.items()
        }
        self.silent, self.unplugged, self.refusals = False, False, 0
        self._connected, self._lock, self._clock = False, threading.RLock(), clock
        self._fault: str | None = None

    def connect(self) -> None:
        """Connect; nothing moves."""
        if self.unplugged:
            raise LinkError(self.name, "it is not plugged in", "plug it in")
        self._connected = True

    def close(self) -> None:
        """Disconnect; safe to call at any time, and twice."""
        self._connected = False

    def home(self, axes: Collection[str]) -> None:
        """Begin to look for the origins of some axes."""
        with self._lock:
            self._refuse_unknown(axes)
            self._transact()
            self._take_refusal()
            self._fault = None
            for name in axes:
                self.mechanisms[name].referenced = False
                self.mechanisms[name].home()

    def move_to(self, targets: Mapping[str, float]) -> None:
        """Begin to move some axes to the steps that are nearest to absolute positions."""
        with self._lock:
            self._refuse_targets(targets, {name for name, axis in self.mechanisms.items() if axis.referenced})
            self._transact()
            self._take_refusal()
            for name in targets:
                if not self.mechanisms[name].motor_on:
                    raise RefusedError(self.name, f"the motor of axis {name} is off", "switch it on")
            for name, target in targets.items():
                resolution = self.axes[name].resolution
                self.mechanisms[name].move_to(round(target / resolution) * resolution)

    def stop(self) -> None:
        """Stop all axes at once."""
        if self.unplugged or not self._connected:
            self._transact()
        for mechanism in self.mechanisms.values():
            mechanism.stop(hard=True)

    def state(self) -> StageState:
        """Return how all axes are."""
        with self._lock:
            self._transact()
            states = {name: self._axis_state(mechanism) for name, mechanism in self.mechanisms.items()}
            hit = [f"axis {name} ran onto a limit switch" for name, axis in self.mechanisms.items() if axis.hit_limit]
            faults = [*([self._fault] if self._fault else []), *hit]
            return StageState(int(self._clock() * 1e9), states, "; ".join(faults) or None)

    def power_cycle(self) -> None:
        """Switch it off and on: all axes stand still and have lost their reference."""
        with self._lock:
            for mechanism in self.mechanisms.values():
                mechanism.power_cycle()
            self._fault = "it has been switched off and on: home its axes"

    @staticmethod
    def _axis_state(mechanism: Mechanism) -> AxisState:
        moving = mechanism.moving  # before the position: whoever does not move is where it stays
        return AxisState(
            mechanism.counter,
            moving=moving,
            referenced=mechanism.referenced,
            at_lower_limit=mechanism.at_lower_switch,
            at_upper_limit=mechanism.at_upper_switch,
        )

    def _transact(self) -> None:
        if self.unplugged:
            raise LinkError(self.name, "the line is gone", "see to cable and power, then connect again")
        if not self._connected:
            raise LinkError(self.name, "it is not connected", "connect first")
        if self.silent:
            raise ReplyTimeoutError(self.name, "no reply", "see that it is switched on")

    def _take_refusal(self) -> None:
        if self.refusals > 0:
            self.refusals -= 1
            raise RefusedError(self.name, "the command was refused", "see that it is at rest")
