"""A rig: axes of several controllers under names of their own, and a force sensor."""

import math
import time
from collections.abc import Callable, Collection, Mapping
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Self, TypeVar

from stage_hardware.errors import HardwareError
from stage_hardware.force_sensor import ForceSensor
from stage_hardware.stage import Axis, AxisState, Stage, StageState

Answer = TypeVar("Answer")


@dataclass(frozen=True)
class Frame:
    """How an axis of a rig counts: 0 at ``start``, where episodes begin, and upwards along the axis or against it."""

    start: float
    inverted: bool = False

    def to_axis(self, position: float) -> float:
        """Return the axis's own position of one that is counted from the start."""
        return self.start - position if self.inverted else self.start + position

    def to_rig(self, position: float) -> float:
        """Return the position, counted from the start, of one of the axis's own."""
        return self.start - position if self.inverted else position - self.start


class Rig:
    """Stages by the names of their controllers, and a force sensor; the names of axes are unique among all stages.

    Positions are in the unit of their axis, um as a rule, from where episodes begin (:class:`Frame`). Controllers are
    asked at the same time, as each is slow by itself. All methods raise a
    :class:`stage_hardware.errors.HardwareError`, if several fail that of the first of the file.
    """

    def __init__(self, stages: Mapping[str, Stage], frames: Mapping[str, Frame], sensor: ForceSensor) -> None:
        """Remember what there is; nothing is connected yet. A frame for each axis."""
        self.stages, self.sensor = MappingProxyType(dict(stages)), sensor
        self.frames = MappingProxyType(dict(frames))
        self.controller_of = MappingProxyType({axis: name for name, stage in stages.items() for axis in stage.axes})
        self.axes: Mapping[str, Axis] = MappingProxyType(
            {name: axis for stage in stages.values() for name, axis in stage.axes.items()}
        )
        self._side_by_side: ThreadPoolExecutor | None = None

    def connect(self) -> None:
        """Connect all stages and start the sensor; nothing moves, and of what fails, nothing is left open."""
        self._side_by_side = ThreadPoolExecutor(len(self.stages), thread_name_prefix="ask a controller")
        try:
            for stage in self.stages.values():
                stage.connect()
            self.sensor.start()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close all, whatever becomes of one of them; safe to call at any time, and twice."""
        with ExitStack() as closing:
            if self._side_by_side is not None:
                closing.callback(self._side_by_side.shutdown)
                self._side_by_side = None
            for stage in self.stages.values():
                closing.callback(stage.close)
            closing.callback(self.sensor.stop)

    def limits(self, axis: str) -> tuple[float, float]:
        """Return the least and the largest position of an axis."""
        ends = (self.frames[axis].to_rig(self.axes[axis].lo), self.frames[axis].to_rig(self.axes[axis].hi))
        return min(ends), max(ends)

    def move_to(self, targets: Mapping[str, float]) -> None:
        """Begin to move some axes; those of one controller in one command, none if a target is beyond limits."""
        own = {axis: self.frames[axis].to_axis(target) for axis, target in targets.items()}
        for axis, target in own.items():
            can = self.axes[axis]
            if not can.lo <= target <= can.hi:
                fault = f"axis {axis} would go to {target:g} {can.unit} of its own"
                cure = f"stay within {can.lo:g}..{can.hi:g} {can.unit}"
                raise HardwareError(self.controller_of[axis], fault, cure)
        of_stages: dict[str, dict[str, float]] = {}
        for axis, target in own.items():
            of_stages.setdefault(self.controller_of[axis], {})[axis] = target
        self._ask({name: partial(self.stages[name].move_to, of_stage) for name, of_stage in of_stages.items()})

    def home(self, axes: Collection[str]) -> None:
        """Begin to look for the origins of some axes."""
        for name, stage in self.stages.items():
            if of_stage := [axis for axis in axes if self.controller_of[axis] == name]:
                stage.home(of_stage)

    def state(self, ask: Callable[[str], StageState] | None = None) -> dict[str, AxisState]:
        """Ask all controllers how their axes are, with positions in the rig's frame.

        ``ask`` asks one by its name, in a thread of its own, if there is more to it than its ``state``. Raises a
        HardwareError for a fault, and for a position that is none.
        """
        states = {}
        questions = {name: stage.state if ask is None else partial(ask, name) for name, stage in self.stages.items()}
        for name, state in self._ask(questions).items():
            if state.fault is not None:
                raise HardwareError(name, state.fault, "see to it, then home its axes")
            for axis, one in state.axes.items():
                position = self.frames[axis].to_rig(one.position)
                if not math.isfinite(position):
                    raise HardwareError(name, f"axis {axis} reports the position {position}", "see to line and encoder")
                states[axis] = AxisState(position, one.moving, one.referenced, one.at_lower_limit, one.at_upper_limit)
        return states

    def wait_until_at_rest(self, within_s: float, poll_s: float = 0.02) -> dict[str, AxisState]:
        """Wait until nothing moves, and return the state then; a HardwareError if that takes longer."""
        ends = time.monotonic() + within_s
        while True:
            states = self.state()
            moving = [axis for axis, state in states.items() if state.moving]
            if not moving:
                return states
            if time.monotonic() > ends:
                for stage in self.stages.values():
                    stage.stop()
                fault = f"{', '.join(moving)} still moves after {within_s:g} s"
                raise HardwareError(self.controller_of[moving[0]], fault, "it was stopped: see what slows it down")
            time.sleep(poll_s)

    def _ask(self, questions: Mapping[str, Callable[[], Answer]]) -> dict[str, Answer]:
        """Ask controllers by their names, at the same time once they are connected, and wait for all."""
        pool = self._side_by_side
        if pool is None or len(questions) < 2:
            return {name: ask() for name, ask in questions.items()}
        asked = {name: pool.submit(ask) for name, ask in questions.items()}
        wait(asked.values())
        return {name: answer.result() for name, answer in asked.items()}

    def __enter__(self) -> Self:
        """Connect."""
        self.connect()
        return self

    def __exit__(self, *_: object) -> None:
        """Close."""
        self.close()
