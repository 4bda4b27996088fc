"""Fields whose model a plugin provides: the registry finds it by the type that the file states."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel, GetCoreSchemaHandler, GetJsonSchemaHandler, ValidationError, ValidationInfo
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, core_schema

from neurorobo.config.faults import faults_of, validation_error
from neurorobo.errors import ConfigError, Fault, NeuroroboError
from neurorobo.plugins import Kind, Registry

REGISTRY = "registry"
"""The entry of pydantic's validation context that holds the registry."""


@dataclass(frozen=True)
class Plugged:
    """Pydantic annotation: ``Annotated[BodyConfig, Plugged("body")]`` is a mapping whose ``key`` names a type.

    The other keys are validated by the model registered for that type. The bare name is a mapping with no other key.
    """

    kind: Kind
    key: str = "type"

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Validate with the registered model, serialise all fields of that model."""
        return core_schema.with_info_plain_validator_function(
            self._validate, serialization=core_schema.plain_serializer_function_ser_schema(_dump)
        )

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """Leave a note, in whose place `neurorobo.config.schema` puts what the registry holds."""
        return {"plugged": {"kind": self.kind, "key": self.key}}

    def _validate(self, value: object, info: ValidationInfo) -> BaseModel:
        assert info.context is not None, "the registry is missing from the validation context"
        try:
            return read_plugged(self.kind, value, info.context[REGISTRY], self.key)
        except ConfigError as error:
            raise validation_error(error.faults, self.kind) from error


def read_plugged(kind: Kind, value: object, registry: Registry, key: str = "type") -> BaseModel:
    """Return ``value`` as the registered model that its ``key`` names; a ConfigError with paths inside ``value``."""
    data = {key: value} if isinstance(value, str) else value
    if not isinstance(data, Mapping):
        raise ConfigError([Fault((), f"must be a mapping with a `{key}`")])
    if not isinstance(data.get(key), str):
        known = ", ".join(registry.names(kind)) or "none"
        raise ConfigError([Fault((key,), f"is missing; it names the kind of {kind}, of which there are: {known}")])
    try:
        entry = registry.entry(kind, data[key])
        model = registry.get(kind, entry.name)
    except NeuroroboError as error:
        raise ConfigError([Fault((key,), str(error))]) from error
    if not (isinstance(model, type) and issubclass(model, BaseModel)):
        fault = f"`{entry.name}` is broken: `{entry.target}` is not a pydantic model; report it to its author"
        raise ConfigError([Fault((key,), fault)])
    data = {**data, key: entry.name.removeprefix("core.")}
    try:
        return model.model_validate(data, context={REGISTRY: registry})
    except ValidationError as error:
        raise ConfigError(faults_of(error, model, data)) from error


def _dump(value: BaseModel) -> dict[str, Any]:
    return value.model_dump(mode="json", by_alias=True)
