"""Fields of a configuration whose model a plugin provides; :mod:`neurorobo.config.plugged_reader` reads them."""

from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel, GetCoreSchemaHandler, GetJsonSchemaHandler, ValidationInfo
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, core_schema

READER = "reader"
"""The entry of pydantic's validation context that reads such a field: (kind, value, key) -> the model."""


@dataclass(frozen=True)
class Plugged:
    """Pydantic annotation: ``Annotated[BodyConfig, Plugged("body")]`` is a mapping whose ``key`` names a type.

    The other keys are validated by the model registered for that type, which must be a subclass of the annotated one.
    The bare name is a mapping with no other key; a model that is already built is taken as it is.
    """

    kind: str
    key: str = "type"

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Validate with the registered model, serialise all fields of that model."""

        def validate(value: object, info: ValidationInfo) -> BaseModel:
            if isinstance(value, source):
                assert isinstance(value, BaseModel)
                return value
            if not info.context or READER not in info.context:
                raise ValueError(f"a {self.kind} by name can only be read where its plugin is known; pass its model")
            model: BaseModel = info.context[READER](self.kind, value, self.key)
            if not issubclass(type(model), source):
                name = f"`{getattr(model, self.key)}`"
                raise ValueError(f"{name} is broken: it is not a {source.__name__}; report it to its author")
            return model

        return core_schema.with_info_plain_validator_function(
            validate, serialization=core_schema.plain_serializer_function_ser_schema(_dump)
        )

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """Leave a note, in whose place `neurorobo.config.schema` puts what the registry holds."""
        return {"plugged": {"kind": self.kind, "key": self.key}}


def _dump(value: BaseModel) -> dict[str, Any]:
    return value.model_dump(mode="json", by_alias=True)
