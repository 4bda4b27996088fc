"""What is known of a rig so far, in a file beside it: each step writes what the next one needs."""

import hashlib
import math
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, ValidationError

from neurorobo.config import document
from neurorobo.config.faults import faults_of, raise_faults
from neurorobo.errors import NeuroroboError
from neurorobo.files import write_whole
from neurorobo.plugins import Registry
from stage_hardware.force_sensor import Component
from stage_hardware.rig.rig_config import FORCE_SENSOR, RigConfig, load_rig

Figure = Annotated[float, BeforeValidator(lambda value: float(f"{value:.5g}") if isinstance(value, float) else value)]
"""A number that was measured: more than five digits of it mean nothing."""

STEPS = ("check", "home", "identify", "calibrate")
OPTIONS = {"home": "--limit 0.5N", "identify": "--touch {axis}", "calibrate": "--touch {axis}"}
"""What has to be said to a step beside the rig file, in examples of commands."""

OLDEST_MS, GAPS = 100.0, 20
"""The age of a reading that stops: so much at least, and so many of the longest gaps between two."""


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


class Check(_Strict):
    """What was seen while nothing moved: how long controllers take to answer, and what the sensor reports."""

    answers_after_ms: dict[str, Figure]
    """The slowest answer of each controller."""
    sensor_rate_Hz: Figure
    sensor_gap_ms: Figure
    """The longest time between two readings."""
    offset: dict[str, Figure]
    noise: dict[str, Figure]
    """Mean and standard deviation of each component, mN and mN*m, from the sensor's own zero."""

    @property
    def oldest_ms(self) -> float:
        """How old a reading may become before the rig is stopped."""
        return max(OLDEST_MS, GAPS * self.sensor_gap_ms)


class Home(_Strict):
    """The largest load that was allowed, and how long each axis has looked for its origin."""

    limit_mN: Figure
    took_s: dict[str, Figure] = {}


class FreeRun(_Strict):
    """What an axis does where it touches nothing."""

    speed_um_s: Figure
    off_um: Figure
    """The largest distance from where it was sent, by the controller's own account."""
    runs_on_um: Figure
    stands_after_ms: Figure
    """How far it went on after a stop on the way, and after how long it was seen to stand."""


class Response(_Strict):
    """How a component of the force follows an axis, in contact: mN/um.

    The error is the standard error, and what steps of the sensor may add to it.
    """

    component: str
    stiffness_mN_um: Figure
    error_mN_um: Figure


class Identify(_Strict):
    """What each axis does when it is sent somewhere, and what the sensor feels of it."""

    axes: dict[str, FreeRun] = {}
    responses: dict[str, Response] = {}


class Calibrate(_Strict):
    """Where episodes begin, in each axis's own coordinates (um), and where contact was found, from the start before."""

    start_um: dict[str, Figure]
    touches_um: list[Figure] = []


class Record(_Strict):
    """All steps so far; ``rig`` is a digest of what the rig file said then."""

    neurorobo_commissioning: Literal[1] = 1
    rig: str
    check: Check | None = None
    home: Home | None = None
    identify: Identify | None = None
    calibrate: Calibrate | None = None


class Commissioning:
    """A rig file and the record beside it, ``<rig>.commissioning.yaml``.

    A NeuroroboError for a file that cannot be read.
    """

    def __init__(self, path: Path, registry: Registry | None = None) -> None:
        """Read both; a record of another rig file, or of an earlier version of it, counts as none."""
        self.path, self.config = path, load_rig(path, registry)
        self.file, self.latch = path.with_suffix(".commissioning.yaml"), self.config.latch(path)
        digest = _digest(self.config)
        found = _read(self.file) if self.file.exists() else None
        self.is_outdated = found is not None and found.rig != digest
        self.record = found if found is not None and not self.is_outdated else Record(rig=digest)

    def save(self) -> None:
        """Write the record, which may be unfinished: the same command goes on from there."""
        content = self.record.model_dump(mode="json", exclude_none=True)
        write_whole(self.file, document.dump(content).encode())

    def command(self, step: str, axis: str = "AXIS") -> str:
        """Return what to type for a step."""
        return " ".join(["neurorobo rig", step, str(self.path), *OPTIONS.get(step, "").format(axis=axis).split()])

    def require(self, step: str) -> None:
        """Refuse what needs a step that was not done, and name the first of those before it."""
        for needed in STEPS[: STEPS.index(step) + 1]:
            if getattr(self.record, needed) is None:
                why = (
                    "the rig file has changed since its commissioning" if self.is_outdated else "that was not done yet"
                )
                raise NeuroroboError(f"{self.path}: this needs `{self.command(needed)}` first; {why}")

    @property
    def forces(self) -> dict[str, Component]:
        """The sensor's components that are forces."""
        components = self.config.force_sensor.build(FORCE_SENSOR).components
        return {name: one for name, one in components.items() if one.unit == "mN"}

    @property
    def noise_mN(self) -> float:
        """The standard deviation of the force, all components together."""
        assert self.record.check is not None
        return math.hypot(*(self.record.check.noise[name] for name in self.forces))

    def least_contact_mN(self) -> float:
        """Return the least load that is beyond noise and resolution of the sensor."""
        self.require("check")
        return max(10 * self.noise_mN, 5 * max(one.resolution for one in self.forces.values()))


def _digest(config: RigConfig) -> str:
    told = config.model_copy(update={"emulate": None}).dump()
    return f"sha256:{hashlib.sha256(told.encode()).hexdigest()}"


def _read(path: Path) -> Record:
    read = document.load_document(path)
    try:
        return Record.model_validate(read.value)
    except ValidationError as error:
        raise_faults(read, faults_of(error, Record, read.value))
        raise  # there is no such error without a fault
