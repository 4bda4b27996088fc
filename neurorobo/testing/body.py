"""Whether a body keeps its contract."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NoReturn

import numpy as np

from neurorobo.bodies import Actuator, Array, Body, BodyConfig, Sensor
from neurorobo.plugins.imports import import_target
from neurorobo.testing.conformance import ConformanceError
from neurorobo.units import UnitError, same_unit

Readings = list[dict[str, Array]]


def check_body(config: BodyConfig, *, period_ns: int = 1_000_000_000, motions: int = 4, batch: int = 3) -> None:
    """Build the simulated body of ``config`` and raise a :class:`ConformanceError` at the first breach of the contract.

    Checked are sensors and actuators; that readings have their widths, are within their ranges, and stay the same until
    something moves; that limits fit their actuators; that equal seeds give equal
    readings, bit for bit; that the ``batch`` bodies do not influence one another; that one which starts again is as
    fresh and leaves the others alone; that commands are left as they are. Commands are drawn within the limits, one
    after each ``period_ns``. Errors that the body itself raises pass through.
    """
    contract = _Contract(config, period_ns, motions, batch)
    contract.check_channels()
    contract.check_limits()
    contract.check_readings()
    contract.check_commands()
    contract.check_seeds()
    contract.check_members()
    contract.check_partial_reset()


@dataclass(frozen=True)
class _Contract:
    """The checks of one body."""

    config: BodyConfig
    period_ns: int
    motions: int
    batch: int

    @property
    def seeds(self) -> Sequence[int]:
        """One for each body of the batch."""
        return range(self.batch)

    def check_channels(self) -> None:
        """Sensors and actuators make sense, before anything is built."""
        channels: tuple[tuple[str, Mapping[str, Sensor | Actuator], Mapping[str, Sensor | Actuator]], ...] = (
            ("sensor", self.config.sensors(), self.config.sensors()),
            ("actuator", self.config.actuators(), self.config.actuators()),
        )
        for kind, ones, others in channels:
            if ones != others:
                self.fail(f"its {kind}s differ from call to call; let them depend on the configuration alone")
            for name, channel in ones.items():
                if not name.isidentifier():
                    self.fail(f"the {kind} `{name}` cannot be referred to; use letters, digits and _")
                if channel.width < 1 or not channel.lo < channel.hi:
                    self.fail(f"the {kind} `{name}` has no room: width {channel.width}, {channel.lo}..{channel.hi}")
                try:
                    same_unit(channel.unit, channel.unit)
                except UnitError as error:
                    self.fail(f"the {kind} `{name}`: {error}; use a unit such as `mN` or `um/s`, or `1`")

    def check_limits(self) -> None:
        """Limits fit their actuators."""
        body = self.build(self.seeds)
        limits = body.limits(self.period_ns)
        if limits.keys() != body.actuators.keys():
            self.fail(f"it limits {', '.join(limits)}, but has {', '.join(body.actuators)}")
        for name, ends in limits.items():
            shape = (self.batch, body.actuators[name].width)
            try:
                lo, hi = (np.broadcast_to(end, shape) for end in ends)
            except ValueError:
                self.fail(f"the limits of `{name}` do not fit commands of the shape {shape}")
            if not (lo <= hi).all():
                self.fail(f"the least command of `{name}` is above the largest")

    def check_readings(self) -> None:
        """Readings are what is declared, and stay until something moves."""
        body = self.build(self.seeds)
        for _ in range(self.motions):
            first = {name: values.copy() for name, values in body.read().items()}
            if first.keys() != body.sensors.keys():
                self.fail(f"it reads {', '.join(first)}, but declares {', '.join(body.sensors)}")
            for name, values in first.items():
                sensor = body.sensors[name]
                if values.shape != (self.batch, sensor.width):
                    self.fail(f"the sensor `{name}` reads {values.shape}, not {(self.batch, sensor.width)}")
                if not ((values >= sensor.lo) & (values <= sensor.hi)).all():
                    self.fail(f"the sensor `{name}` reads what is out of its range {sensor.lo}..{sensor.hi}")
            if difference := _difference([first], [body.read()]):
                self.fail(f"{difference} another value the second time; draw noise when it moves")
            body.advance(self.commands(body, 0), self.period_ns)

    def check_commands(self) -> None:
        """Commands are only read, and a body may be stopped at any time."""
        body = self.build(self.seeds)
        commands = self.commands(body, 0)
        kept = {name: values.copy() for name, values in commands.items()}
        body.advance(commands, self.period_ns)
        for name, values in commands.items():
            if not np.array_equal(values, kept[name]):
                self.fail(f"it changes the command `{name}` that it was given; copy it")
        body.stop()
        body.stop()

    def check_seeds(self) -> None:
        """Equal seeds, equal readings, also of the same body once it starts again."""
        body = self.build(self.seeds)
        first = self.run(body)
        body.reset(self.seeds)
        for again in (self.run(self.build(self.seeds)), self.run(body)):
            if difference := _difference(first, again):
                self.fail(f"{difference} another value with the same seed; draw from a generator that `reset` seeds")

    def check_members(self) -> None:
        """What happens to a body does not depend on its batch."""
        together = self.run(self.build(self.seeds))
        for i, seed in enumerate(self.seeds):
            alone = self.run(self.build([seed]), member=i)
            if difference := _difference([_row(reading, i) for reading in together], alone):
                self.fail(f"{difference} another value alone than in a batch; give each body a generator of its own")

    def check_partial_reset(self) -> None:
        """A body that starts again is as fresh, and leaves the others alone."""
        body, undisturbed = self.build(self.seeds), self.build(self.seeds)
        self.run(body)
        self.run(undisturbed)
        body.reset([self.batch], np.arange(self.batch) == 0)
        after, fresh = self.run(body), self.run(self.build([self.batch]), member=0)
        going_on = self.run(undisturbed)
        if difference := _difference(fresh, [_row(reading, 0) for reading in after]):
            self.fail(
                f"{difference} another value after a partial reset than at a fresh start; reset all that it keeps"
            )
        for i in range(1, self.batch):
            if difference := _difference([_row(r, i) for r in going_on], [_row(r, i) for r in after]):
                self.fail(f"{difference} another value as another body started again; reset only those that are marked")

    def build(self, seeds: Sequence[int]) -> Body:
        """Return the body, at its start."""
        body: Body = import_target(self.config.implementation)(self.config)
        body.reset(seeds)
        return body

    def commands(self, body: Body, motion: int, member: int | None = None) -> dict[str, Array]:
        """Return commands within the limits, the same share of them for a member alone as in the batch."""
        generator = np.random.default_rng(motion)
        commands = {}
        for name, (lo, hi) in body.limits(self.period_ns).items():
            share = generator.random((self.batch, body.actuators[name].width))
            share = share if member is None else share[member : member + 1]
            lo = np.where(np.isfinite(lo), lo, np.minimum(hi, 1.0) - 2.0)
            hi = np.where(np.isfinite(hi), hi, lo + 2.0)
            commands[name] = lo + share * (hi - lo)
        return commands

    def run(self, body: Body, member: int | None = None) -> Readings:
        """Move a body and return what it reads after each motion."""
        readings = []
        for motion in range(self.motions):
            body.advance(self.commands(body, motion, member), self.period_ns)
            readings.append({name: values.copy() for name, values in body.read().items()})
        return readings

    def fail(self, fault: str) -> NoReturn:
        """Raise, naming the body."""
        raise ConformanceError(f"`{self.config.type}`: {fault}")


def _row(reading: Mapping[str, Array], i: int) -> dict[str, Array]:
    return {name: values[i : i + 1] for name, values in reading.items()}


def _difference(ones: Readings, others: Readings) -> str | None:
    """Name the first sensor that reads differently."""
    for one, other in zip(ones, others, strict=True):
        for name in one:
            if not np.array_equal(one[name], other[name]):
                return f"the sensor `{name}` reads"
    return None
