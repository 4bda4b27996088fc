"""The JSON Schema of the experiment file, for editors: it holds what the registered types allow."""

import copy
import json
from collections.abc import Iterable, Iterator
from typing import Any

from pydantic import BaseModel, TypeAdapter
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue, models_json_schema
from pydantic_core import SchemaSerializer, core_schema

from neurorobo.config.experiment import Experiment, Repeat, Step
from neurorobo.errors import NeuroroboError
from neurorobo.plugins import Kind, Registry
from neurorobo.units import Duration

Schema = dict[str, Any]


def experiment_schema(registry: Registry) -> Schema:
    """Return the schema, its keys in the same order every time; types that cannot be imported are left out."""
    kinds: set[Kind] = set()
    while not (found := {note["plugged"]["kind"] for note in _notes(_generate(registry, kinds))}) <= kinds:
        kinds |= found  # a registered type can have fields of further kinds
    root = _generate(registry, kinds)
    definitions = root["$defs"]
    places: set[tuple[Kind, str]] = set()
    for note in [*_notes(root)]:
        plugged = note.pop("plugged")
        places.add((plugged["kind"], plugged["key"]))
        note["$ref"] = f"#/$defs/{_named_by(**plugged)}"
    for kind, key in sorted(places):
        # Phases of training and what synapses learn by are rules both: a type belongs where its model has the key.
        names = [name for name, model in _models(registry, kind) if key in model.model_fields]
        for name in names:
            definitions[f"{kind} {name}"] = _of_type(definitions[f"{kind} {name}"], key, name)
        choices = [_bare(names), *({"$ref": f"#/$defs/{kind} {name}"} for name in names)]
        definitions[_named_by(kind, key)] = {"oneOf": choices} if names else False
    if recorders := registry.names("recorder"):
        root["properties"]["record"]["items"] = _bare(recorders)
    return root


def _generate(registry: Registry, kinds: Iterable[Kind]) -> Schema:
    """Return the schema with `Plugged`'s notes in it, and a definition for every type of these kinds."""
    types = {f"{kind} {name}": model for kind in sorted(kinds) for name, model in _models(registry, kind)}
    unordered: set[type[BaseModel]] = {Experiment, Step, Repeat, *types.values()}
    models = sorted(unordered, key=lambda model: (model.__module__, model.__qualname__))
    references, generated = models_json_schema([(model, "validation") for model in models], schema_generator=_Generator)
    definitions: Schema = generated["$defs"]
    names = {model: references[model, "validation"]["$ref"].removeprefix("#/$defs/") for model in models}
    definitions[names[Step]]["additionalProperties"] = {"type": "string"}
    definitions[names[Repeat]]["properties"]["steps"] |= _steps(names[Step])
    top = definitions.pop(names[Experiment])
    top["properties"]["steps"] |= _steps(names[Step], names[Repeat])
    top["properties"]["time"] |= _time()
    definitions |= {name: copy.deepcopy(definitions[names[model]]) for name, model in types.items()}
    root = {"$schema": GenerateJsonSchema.schema_dialect, **top, "title": "neurorobo experiment", "$defs": definitions}
    return _used(root, types)


class _Generator(GenerateJsonSchema):
    """Shows defaults as they are written in a file, and no titles that only repeat a field's name."""

    def default_schema(self, schema: core_schema.WithDefaultSchema) -> JsonSchemaValue:
        json_schema = super().default_schema(schema)
        if "default" in json_schema:
            serializer = (
                SchemaSerializer(core_schema.any_schema()) if _refers(schema) else SchemaSerializer(schema["schema"])
            )
            json_schema["default"] = serializer.to_python(schema["default"], mode="json", by_alias=True)
        return json_schema

    def field_title_should_be_set(self, schema: Any) -> bool:
        return False


def _refers(schema: object) -> bool:
    """Whether a core schema points to a definition that stands elsewhere, so that it cannot be compiled alone."""
    if isinstance(schema, dict):
        return schema.get("type") == "definition-ref" or any(map(_refers, schema.values()))
    return isinstance(schema, list | tuple) and any(map(_refers, schema))


def _models(registry: Registry, kind: Kind) -> Iterator[tuple[str, type[BaseModel]]]:
    for name in registry.names(kind):
        try:
            target = registry.get(kind, name)
        except NeuroroboError:
            continue
        if isinstance(target, type) and issubclass(target, BaseModel):
            yield name, target


def _of_type(definition: Schema, key: str, name: str) -> Schema:
    properties = {**definition["properties"], key: {"enum": _spellings(name)}}
    required = sorted({*definition.get("required", ()), key})
    return {**definition, "title": name, "properties": properties, "required": required}


def _named_by(kind: Kind, key: str) -> str:
    """Return the name of the definition of all types of a kind that a file names under a key."""
    return kind if key == "type" else f"{kind} by its {key}"


def _bare(names: Iterable[str]) -> Schema:
    return {"enum": [spelling for name in names for spelling in _spellings(name)]}


def _spellings(name: str) -> list[str]:
    """Return the ways to write a type's name: the core's may be written without its prefix."""
    return [name, name.removeprefix("core.")] if name.startswith("core.") else [name]


def _steps(step: str, repeat: str | None = None) -> Schema:
    """Return the schema of a list of steps: mappings of one name to a step, and repeats."""
    one = {
        "type": "object",
        "minProperties": 1,
        "maxProperties": 1,
        "additionalProperties": {"$ref": f"#/$defs/{step}"},
    }
    if repeat is None:
        items = one
    else:
        # Without the condition, an editor would offer the keys of both.
        items = {"if": {"required": ["repeat"]}, "then": {"$ref": f"#/$defs/{repeat}"}, "else": one}
    return {"type": "array", "minItems": 1, "items": items}


def _time() -> Schema:
    duration = TypeAdapter(Duration).json_schema()
    return {
        "type": "object",
        "properties": {"control": duration, "spike_step": duration, "window": {"type": "integer", "minimum": 1}},
        "required": ["control"],
        "additionalProperties": duration,
    }


def _notes(schema: object) -> Iterator[Schema]:
    """Yield every place where `Plugged` has left a note."""
    if isinstance(schema, dict):
        if isinstance(schema.get("plugged"), dict) and set(schema["plugged"]) == {"kind", "key"}:
            yield schema
        schema = list(schema.values())
    if isinstance(schema, list):
        for part in schema:
            yield from _notes(part)


def _used(root: Schema, types: Iterable[str]) -> Schema:
    """Return the schema without the definitions that nothing refers to, those of the registered types apart."""
    text = json.dumps(root, ensure_ascii=False)
    used = {name: part for name, part in root["$defs"].items() if name in types or f'"#/$defs/{name}"' in text}
    return {**root, "$defs": used}
