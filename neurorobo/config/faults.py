"""Plain faults and their places: ``file.yaml:7:5: regions.cortex.size: must be greater than 0 (got -3)``."""

import re
import types
from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated, Any, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails, InitErrorDetails, PydanticCustomError

from neurorobo.config.document import Document, DocumentPath
from neurorobo.errors import ConfigError, Fault, did_you_mean
from neurorobo.units import UnitError

_READY = "neurorobo"
"""The pydantic error type of a message that needs no more translation."""

_MESSAGES = {
    "missing": "is missing",
    "model_type": "must be a mapping",
    "model_attributes_type": "must be a mapping",
    "dict_type": "must be a mapping",
    "list_type": "must be a list",
    "tuple_type": "must be a list",
    "string_type": "must be text",
    "bool_type": "must be true or false",
    "bool_parsing": "must be true or false",
    "int_type": "must be a whole number",
    "int_parsing": "must be a whole number",
    "int_from_float": "must be a whole number",
    "float_type": "must be a number",
    "float_parsing": "must be a number",
}


def raise_faults(document: Document, faults: Iterable[Fault], *, alone: bool = False) -> None:
    """Raise a ConfigError with every fault on a line of its own, in the order of their places, if there are any.

    Where the file is at fault, a note tells the overrides that are not named: one part of a file can spoil another,
    unless each is at fault ``alone``.
    """
    ordered = sorted(dict.fromkeys(faults), key=lambda fault: document.order(fault.path))
    if ordered:
        lines = [f"{document.place(fault.path)}: {fault}" for fault in ordered]
        named = {text for fault in ordered for text in document.overrides_at(fault.path)}
        unnamed = [f"--set {text}" for _, text in document.overrides if text not in named]
        if unnamed and not alone and not all(line.startswith("--set ") for line in lines):
            lines.append(f"note: the file was read with {' '.join(unnamed)}, which may be the cause")
        raise ConfigError(ordered, lines)


def faults_of(error: ValidationError, model: type[BaseModel], data: object) -> list[Fault]:
    """Return pydantic's errors as faults, with paths inside ``data``, which ``model`` has refused."""
    found: dict[DocumentPath, list[str]] = {}
    for details in error.errors(include_url=False):
        path = _path(details, data)
        messages = found.setdefault(path, [])
        message = _message(details, model)
        if message not in messages:
            messages.append(message)
    # A value that suits no member of a union has errors for each. Those at one place are joined; where there are
    # errors inside the value, those of other members about the whole of it are left out.
    outer = {path[:length] for path in found for length in range(len(path))}
    return [Fault(path, "; or ".join(messages)) for path, messages in found.items() if path not in outer]


def validation_error(faults: Iterable[Fault], title: str) -> ValidationError:
    """Return faults as the error that a validator inside a pydantic model raises; their paths start at its field."""
    return ValidationError.from_exception_data(
        title,
        [
            InitErrorDetails(
                type=PydanticCustomError(_READY, "{message}", {"message": fault.message}), loc=fault.path, input=None
            )
            for fault in faults
        ],
    )


def _path(details: ErrorDetails, data: object) -> DocumentPath:
    """Return the error's location without what pydantic adds to it: the tags of unions and the like."""
    path: list[str | int] = []
    for part in details["loc"]:
        if isinstance(data, Mapping | Sequence) and not isinstance(data, str):
            try:
                data = data[part]  # type: ignore[index]  # a part of the wrong type is caught
            except (KeyError, IndexError, TypeError):
                continue
            path.append(part)
    last = details["loc"][-1:]
    if details["type"] in ("missing", _READY) and tuple(path[-1:]) != last:
        path.extend(last)
    if details["type"].startswith("union_tag"):
        path.append(_discriminator(details))
    return tuple(path)


def _message(details: ErrorDetails, model: type[BaseModel]) -> str:
    kind, context, value = details["type"], details.get("ctx", {}), details["input"]
    message = _MESSAGES.get(kind, "")
    if kind == _READY:
        return str(context["message"])
    match kind:
        case "missing":
            if isinstance(value, Sequence):  # of a list with a place for each value, such as x, y and z
                return f"is missing: the list has {_values(len(value))} and needs more; add it"
            return message
        case "too_long" | "too_short":
            given = _values(context["actual_length"])
            if kind == "too_long":
                return f"has {given}, and takes at most {context['max_length']}; remove the rest"
            return f"has {given}, and needs at least {context['min_length']}; add some"
        case "extra_forbidden":
            *path, key = details["loc"]
            return f"unknown key `{key}`{did_you_mean(str(key), _keys(model, path))}"
        case "value_error" | "assertion_error":
            message = str(context["error"])
            if isinstance(context["error"], UnitError) or isinstance(value, Mapping | list | tuple):
                return message  # that a mapping was got is no news where it is read, and then found wrong
        case "literal_error" | "enum" | "union_tag_invalid":
            allowed = str(context.get("expected", context.get("expected_tags")))
            value = context.get("tag", value)
            near = did_you_mean(value, re.findall("'(.*?)'", allowed)) if isinstance(value, str) else ""
            hint = near if "did you mean" in near else ""
            return f"must be {allowed}{_got(value)}{hint}"
        case "union_tag_not_found":
            return "is missing"
    if not message:
        message = re.sub(r"^[A-Z]\w* should ", "must ", details["msg"])
    return message + ("" if _shown(value) in message else _got(value))


def _values(count: int) -> str:
    return f"{count} value{'' if count == 1 else 's'}"


def _discriminator(details: ErrorDetails) -> str:
    return str(details["ctx"]["discriminator"]).strip("'")


def _got(value: object) -> str:
    return f" (got {_shown(value)})"


def _shown(value: object) -> str:
    match value:
        case None:
            return "nothing"
        case bool():
            return str(value).lower()
        case str():
            return repr(value if len(value) <= 60 else value[:57] + "...")
        case int() | float():
            return str(value)
        case Mapping():
            return "a mapping"
        case Sequence():
            return "a list"
    return type(value).__name__


def _keys(model: type[BaseModel], path: Iterable[str | int]) -> set[str]:
    """Return the keys that are allowed at a location, those of all models where a union leaves open which is meant."""
    models = [model]
    for part in path:
        tagged = [member for member in models if _is_tagged(member, part)]
        inner = [
            found
            for member in models
            for name, info in member.model_fields.items()
            if part in (name, info.alias)
            for found in _models_in(info.annotation)
        ]
        models = inner or tagged or models
    return {info.alias or name for member in models for name, info in member.model_fields.items()}


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    if get_origin(annotation) is Annotated:
        return _models_in(get_args(annotation)[0])
    if get_origin(annotation) in (Union, types.UnionType, list, tuple, dict, set, frozenset, Mapping, Sequence):
        return [model for argument in get_args(annotation) for model in _models_in(argument)]
    return []


def _is_tagged(model: type[BaseModel], tag: object) -> bool:
    return model.__name__ == tag or any(tag in get_args(info.annotation) for info in model.model_fields.values())
