"""The rig file: controllers with their axes, a force sensor, and what emulated ones feel."""

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ModelWrapValidatorHandler,
    ValidationError,
    ValidationInfo,
    model_validator,
)

from neurorobo.config import document
from neurorobo.config.experiment import Name
from neurorobo.config.faults import faults_of, raise_faults, validation_error
from neurorobo.config.plugged_reader import REGISTRY, validation_context
from neurorobo.errors import Fault, NeuroroboError, did_you_mean
from neurorobo.plugged_field import Plugged
from neurorobo.plugins import Registry
from neurorobo.safety.machine import Latch
from stage_hardware.rig.device_config import AxisConfig, DeviceConfig, ForceSensorConfig, StageConfig
from stage_hardware.rig.physics import PhysicsConfig
from stage_hardware.rig.rig import Frame, Rig

HINT = "a rig file starts with 'neurorobo_rig: 1'"

FORCE_SENSOR = "force_sensor"
"""What the sensor is called in messages."""


def _file_name(text: str) -> str:
    if not re.fullmatch(r"[A-Za-z0-9][\w.-]*", text, re.ASCII):
        raise ValueError("names files: it must be of letters, digits, '_', '.' and '-'")
    return text


def _is(base: type[DeviceConfig], what: str) -> BeforeValidator:
    """Return what refuses devices of the other sort: both are registered as devices."""

    def validate(value: object, info: ValidationInfo) -> object:
        name = value.get("type") if isinstance(value, Mapping) else value
        if isinstance(name, str) and info.context:
            try:
                model = info.context[REGISTRY].get("device", name)
            except NeuroroboError:
                return value  # told where it is read
            if isinstance(model, type) and issubclass(model, DeviceConfig) and not issubclass(model, base):
                there = "force_sensor" if issubclass(model, ForceSensorConfig) else "controllers"
                fault = Fault(("type",), f"`{name}` is no {what}; put it under `{there}`")
                raise validation_error([fault], what)
        return value

    return BeforeValidator(validate)


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Emulation(_Strict):
    """What only an emulated rig has."""

    physics: Annotated[PhysicsConfig, Plugged("physics")] = Field(description="What its force sensor feels.")


class RigConfig(_Strict):
    """Everything that a rig file says, checked but not yet built."""

    neurorobo_rig: Literal[1] = Field(description="The version of the file format.")
    name: Annotated[str, AfterValidator(_file_name)] = Field(description="Names the rig, and files about it.")
    controllers: dict[Name, Annotated[StageConfig, Plugged("device"), _is(StageConfig, "stage")]] = Field(
        min_length=1, description="The controllers, by name; the names of axes are unique among all of them."
    )
    force_sensor: Annotated[ForceSensorConfig, Plugged("device"), _is(ForceSensorConfig, "force sensor")] = Field(
        description="The force sensor."
    )
    emulate: Emulation | None = Field(default=None, description="What an emulated rig feels; devices need it not.")

    @model_validator(mode="wrap")
    @classmethod
    def _fits_together(cls, data: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        """Tell what does not fit together beside what is wrong by itself."""
        faults = [*_misfits(data)] if isinstance(data, Mapping) else []
        try:
            config = handler(data)
        except ValidationError as error:
            faults += faults_of(error, cls, data)
        if faults:
            raise validation_error(faults, cls.__name__)
        return config

    @classmethod
    def from_document(cls, read: document.Document, registry: Registry) -> Self:
        """Check a document against the devices of all plugins; a ConfigError lists all faults."""
        try:
            return cls.model_validate(read.value, context=validation_context(registry))
        except ValidationError as error:
            raise_faults(read, faults_of(error, cls, read.value))
            raise  # there is no such error without a fault

    @property
    def axes(self) -> dict[str, AxisConfig]:
        """The axes of all controllers, whose names are their own."""
        return {name: axis for stage in self.controllers.values() for name, axis in stage.axes.items()}

    @property
    def frames(self) -> dict[str, Frame]:
        """How each axis counts in the rig."""
        return {name: axis.frame for name, axis in self.axes.items()}

    def latch(self, path: Path) -> Latch:
        """Return the latch of the rig that ``path`` describes; it is kept by name, as several files may do so."""
        return Latch(path.with_name(f"{self.name}.latch.json"), reset=f"neurorobo rig reset {path}")

    def build(self) -> Rig:
        """Return the rig; nothing is connected yet."""
        stages = {name: stage.build(name) for name, stage in self.controllers.items()}
        return Rig(stages, self.frames, self.force_sensor.build(FORCE_SENSOR))

    def dump(self) -> str:
        """Return it as YAML that loads again to an equal one, with every default written out."""
        return document.dump(_without_nothing(self.model_dump(mode="json")))


def load_rig(path: str | Path, registry: Registry | None = None) -> RigConfig:
    """Read and check a rig file, by default with all installed plugins.

    Raises a ConfigError with every fault on a line of its own: place, path, what is wrong, what is allowed.
    """
    return RigConfig.from_document(_document(path), Registry.discover() if registry is None else registry)


def _document(path: str | Path) -> document.Document:
    if not Path(path).exists():
        raise NeuroroboError(
            f"{path}: there is no such file; that of a virtual rig is there while `neurorobo emulate` runs"
        )
    read = document.load_document(path)
    if "neurorobo" in read.value and "neurorobo_rig" not in read.value:
        raise NeuroroboError(f"{path}: this is an experiment, not a rig; {HINT}")
    return read


def _misfits(data: Mapping[str, Any]) -> Iterator[Fault]:
    """Yield ports of several controllers, axes of one name, and axes that physics depends on and that are not there."""
    owners, plugged = dict[str, str](), dict[str, str]()
    for controller, stage in _mapping(data.get("controllers")).items():
        port = getattr(stage, "port", _mapping(stage).get("port"))
        if isinstance(port, str) and plugged.setdefault(port, controller) != controller:
            fault = f"is that of `{plugged[port]}` too (got '{port}'); each controller has its own"
            yield Fault(("controllers", controller, "port"), fault)
        axes = stage.axes if isinstance(stage, StageConfig) else _mapping(_mapping(stage).get("axes"))
        for axis in axes:
            if axis in owners:
                fault = f"there is an axis `{axis}` of `{owners[axis]}` already; give each a name of its own"
                yield Fault(("controllers", controller, "axes", axis), fault)
            owners.setdefault(axis, controller)
    emulate = data.get("emulate")
    physics = emulate.physics if isinstance(emulate, Emulation) else _mapping(emulate).get("physics")
    needed = physics.axes if isinstance(physics, PhysicsConfig) else _mapping(physics).get("axes")
    for index, axis in enumerate(needed if isinstance(needed, list | tuple) else ()):
        if isinstance(axis, str) and owners and axis not in owners:
            fault = f"the rig has no axis `{axis}`{did_you_mean(axis, owners)}"
            yield Fault(("emulate", "physics", "axes", index), fault)


def _mapping(value: object) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}


def _without_nothing(value: Any) -> Any:
    """Leave out what is None, which is what a key that is not there stands for."""
    if isinstance(value, dict):
        return {key: _without_nothing(inner) for key, inner in value.items() if inner is not None}
    return value
