"""The insertion body on real stages: where it is sent and what it feels come from controllers and a sensor."""

import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from itertools import chain
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from stage_hardware.force_sensor import ForceReading, ForceSensor
from stage_hardware.rig.dry_run import DryRun
from stage_hardware.rig.rig import Rig
from stage_hardware.rig.rig_config import RigConfig, load_rig
from stage_hardware.rig.supervised_rig import ForceWatch, SupervisedRig

from neurorobo.bodies.body import Array
from neurorobo.errors import ConfigError, Fault, NeuroroboError
from neurorobo.safety.machine import Latch, SafetyError, SafetyMachine
from precision_interaction.rig.hardware_rig_config import HardwareRigConfig
from precision_interaction.rig.insertion_body import InsertionBody

LONGEST_MOVE_UM = 150.0
"""The longest move on the way to the start."""


class HardwareRig(InsertionBody):
    """One insertion on the rig of a file, supervised: each episode begins at the start, homed, biased and free.

    Nothing is connected before :meth:`reset`, which a rig that was not armed refuses. What goes wrong stops the rig and
    raises a SafetyError.
    """

    config: HardwareRigConfig
    largest_batch: ClassVar[int | None] = 1

    def __init__(self, config: HardwareRigConfig) -> None:
        super().__init__(config)
        try:
            self._rig_config = load_rig(config.rig)
        except NeuroroboError as error:  # whose places are in the file of the rig, not in that of the body
            raise ConfigError([Fault(("rig",), str(error))]) from None
        self._check(self._rig_config)
        self._machine = SafetyMachine(self._rig_config.latch(Path(config.rig)))
        self._supervised: SupervisedRig | None = None
        self._rehearsal = ExitStack()
        self._axial_force_mN, self._paced = 0.0, False
        super().reset([])

    def arm(self, *, dry_run: bool = False) -> None:
        """Allow the rig to move; in a dry run, emulators take its place, and what they are sent is shown."""
        rig = self._rig_config
        if dry_run:
            rig = self._rehearsal.enter_context(DryRun(rig))
            folder = self._rehearsal.enter_context(TemporaryDirectory())
            self._machine = SafetyMachine(Latch(Path(folder) / "latch.json"))  # a rehearsal latches no rig
        self._machine.arm()
        self._supervised = self._supervise(rig.build())

    def reset(self, seeds: Sequence[int], which: NDArray[np.bool_] | None = None) -> None:
        """Withdraw the peg, go to the start, and bias the sensor; `seeds` is one number, which nothing depends on."""
        if len(seeds) > 1:
            raise NeuroroboError("body: there is one rig; run its episodes one after the other")
        if which is not None and not which.all():
            return
        super().reset(seeds, which)
        if not len(seeds):
            return
        rig = self._rig
        rig.begin()
        config = self.config
        self._free(None)
        rig.withdraw(LONGEST_MOVE_UM)
        rig.home([[config.axial], list(config.radial)])
        rig.go_to({config.axial: 0.0}, LONGEST_MOVE_UM)
        self._free(config.free_force)
        rig.go_to(dict.fromkeys(config.radial, 0.0), LONGEST_MOVE_UM)
        rig.bias()
        self._paced = False
        self.force_mN = self._felt_mN(rig.feel())

    def read(self) -> dict[str, Array]:
        """Return the forces, the axial distances and the radial position."""
        return {**super().read(), "axial_force": np.full((len(self.travel_um), 1), self._axial_force_mN)}

    def advance(self, commands: Mapping[str, Array], duration_ns: int) -> None:
        """Move for `duration_ns` of the wall clock."""
        super().advance(commands, duration_ns)
        config, at = self.config, self._at_um  # where the axes are, by their own account
        self.travel_um = np.array([at[config.axial]])
        self.stage_um = np.array([[at[axis] for axis in config.radial]])

    def stop(self) -> None:
        """Stop all axes, and see that they stand."""
        super().stop()
        if self._supervised is not None:
            self._supervised.halt()

    def standstill(self) -> str:
        """Say that all axes stand, and how soon they did."""
        return "" if self._supervised is None else self._supervised.standstill()

    def close(self) -> None:
        """Withdraw the peg, if that is wanted and nothing is wrong, and let go of the rig."""
        is_well = sys.exc_info()[0] is None  # after an error or Ctrl-C, nothing moves by itself
        try:
            if is_well and self.config.at_end == "withdraw" and self._supervised and self._supervised.may_move:
                self._supervised.begin()
                self._free(None)
                self._supervised.withdraw(LONGEST_MOVE_UM)
                self._supervised.halt()
        finally:
            if self._supervised is not None:
                self._supervised.close()
            self._rehearsal.close()

    def timing(self) -> dict[str, Any]:
        """Return latencies, and what became of the deadlines."""
        return {**super().timing(), **({} if self._supervised is None else self._supervised.timing())}

    def _force_after_mN(self, travel_um: Array, stage_um: Array, duration_ns: int) -> Array:
        config, rig = self.config, self._rig
        if travel_um[0] > config.gap:
            self._free(None)
        if not self._paced:  # periods count from the first command: the first answer of a brain takes longest
            rig.start_pace()
            self._paced = True
        rig.send({config.axial: float(travel_um[0]), **dict(zip(config.radial, stage_um[0].tolist(), strict=True))})
        self.latencies.commanded()
        self._at_um = {name: state.position for name, state in rig.end_period(duration_ns).items()}
        return self._felt_mN(rig.feel())

    def _felt_mN(self, reading: ForceReading) -> Array:
        """Return the force (1, 3) of a reading, radial components as moves lower them."""
        signs, names = self.config.force_signs, self.config.force
        radial = [sign * reading.values[name] for sign, name in zip(signs, names, strict=True)]
        self._axial_force_mN = reading.values[self.config.axial_force]
        return np.array([[*radial, self._axial_force_mN]])

    @property
    def _rig(self) -> SupervisedRig:
        if self._supervised is None:
            raise SafetyError(
                "body: it moves real stages; say `--arm` to let it, or `--dry-run` to see what they would be sent"
            )
        return self._supervised

    def _free(self, limit_mN: float | None) -> None:
        for watch in self._rig.force_watches:
            watch.free(limit_mN)

    def _supervise(self, rig: Rig) -> SupervisedRig:
        config = self.config
        names = self._components()
        watches = [
            ForceWatch(guard.name, names[guard.name], guard.limits) for guard in self.guards() if guard.name in names
        ]
        return SupervisedRig(
            rig,
            self._machine,
            watches,
            overrun=config.overrun,
            following_error=config.following_error,
            retracts=config.retraction.distance,
            retracts_by=config.retraction.step,
            load=lambda reading: math.hypot(*(reading.values[name] for name in (*config.force, config.axial_force))),
        )

    def _components(self) -> dict[str, tuple[str, ...]]:
        """Return which components of the rig's sensor make up those of the body."""
        return {"force": self.config.force, "axial_force": (self.config.axial_force,)}

    def _misfits(self, sensor: ForceSensor) -> Iterator[str]:
        """Yield components that are no forces, and limits that the sensor would saturate below."""
        names = self._components()
        for name in chain(*names.values()):
            if sensor.components[name].unit != "mN":
                yield f"the sensor's component `{name}` is in {sensor.components[name].unit}, and is no force"
        for guard in self.guards():
            largest_mN = min((sensor.components[name].largest for name in names.get(guard.name, ())), default=math.inf)
            for key, limit_mN in (("stop", guard.limits.stop), ("latch", guard.limits.latch)):
                if limit_mN is not None and limit_mN >= largest_mN:
                    yield (
                        f"`safety.{guard.name}.{key}` of {limit_mN:g} mN would never be seen, as the sensor tells "
                        f"{largest_mN:g} mN at most; lower it"
                    )

    def _check(self, rig_config: RigConfig) -> None:
        """Refuse a rig that lacks what the body names, or cannot go where and as fast as it will be sent."""
        config, rig = self.config, rig_config.build()
        faults = [
            f"the rig has no axis `{axis}`; it has {', '.join(rig.axes)}"
            for axis in (config.axial, *config.radial)
            if axis not in rig.axes
        ]
        faults += [
            f"the sensor has no component `{name}`; it has {', '.join(rig.sensor.components)}"
            for name in (*config.force, config.axial_force)
            if name not in rig.sensor.components
        ]
        if not faults:
            faults += self._misfits(rig.sensor)
            lo, hi = rig.limits(config.axial)
            if not lo <= 0 <= config.length <= hi:
                faults.append(f"axis `{config.axial}` can go {lo:g}..{hi:g} um and would go 0..{config.length:g} um")
            if rig.axes[config.axial].speed < config.max_speed:
                faults.append(
                    f"axis `{config.axial}` moves at {rig.axes[config.axial].speed:g} um/s; lower `max_speed`"
                )
            faults += [
                f"axis `{axis}` counts in {rig.axes[axis].unit}, not in um"
                for axis in (config.axial, *config.radial)
                if rig.axes[axis].unit != "um"
            ]
        if faults:
            raise NeuroroboError(f"{config.rig}: {'; '.join(faults)}")
