"""Reads fields whose model a plugin provides: the registry finds it by the type that the file states."""

from collections.abc import Mapping

from pydantic import BaseModel, ValidationError

from neurorobo.config.faults import faults_of, validation_error
from neurorobo.errors import ConfigError, Fault, NeuroroboError
from neurorobo.plugged_field import READER
from neurorobo.plugins import Kind, Registry

REGISTRY = "registry"
"""The entry of pydantic's validation context that holds the registry."""


def validation_context(registry: Registry) -> dict[str, object]:
    """Return the context in which pydantic can validate models with `Plugged` fields."""

    def read(kind: Kind, value: object, key: str) -> BaseModel:
        try:
            return read_plugged(kind, value, registry, key)
        except ConfigError as error:
            raise validation_error(error.faults, kind) from error

    return {REGISTRY: registry, READER: read}


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
        return model.model_validate(data, context=validation_context(registry))
    except ValidationError as error:
        raise ConfigError(faults_of(error, model, data)) from error
