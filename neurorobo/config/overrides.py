"""Overrides from the command line: ``--set train.0.steps=300``."""

import copy
from collections.abc import Iterable
from typing import Any

from neurorobo.config.document import Document, DocumentPath, parse_value
from neurorobo.errors import ConfigError, Fault, NeuroroboError, dotted


def apply_overrides(document: Document, overrides: Iterable[str]) -> Document:
    """Return the document with every ``a.b.0.c=value`` applied: a YAML value; list items by index, keys created.

    A ConfigError lists all overrides that do not fit the document.
    """
    faults: list[Fault] = []
    lines: list[str] = []
    for text in overrides:
        name, equals, value_text = text.partition("=")
        path: DocumentPath = tuple(part.strip() for part in name.split("."))
        try:
            if not equals or not all(path):
                raise NeuroroboError("is not of the form key.key=value")
            value = copy.deepcopy(document.value)
            path = _set(value, path, parse_value(value_text, f"--set {text}"))
        except ConfigError as error:  # the value is not YAML
            faults += error.faults
            lines += str(error).splitlines()
        except NeuroroboError as error:
            faults.append(Fault(path, str(error)))
            lines.append(f"--set {text}: {error}")
        else:
            document = document.overridden(value, path, text)
    if faults:
        raise ConfigError(faults, lines)
    return document


def _set(value: Any, path: DocumentPath, new: Any) -> DocumentPath:
    """Set in place and return the path of what is new, with the indices of lists as integers."""
    walked: list[str | int] = []
    new_from: DocumentPath | None = None
    for part in path[:-1]:
        key = _key(value, part, walked)
        if isinstance(value, dict) and value.get(key) is None:
            value[key] = {}
        walked.append(key)
        if isinstance(value[key], str):  # `planner` is short for `{type: planner}`
            value[key] = {"type": value[key]}
            new_from = new_from or tuple(walked)
        value = value[key]
    key = _key(value, path[-1], walked)
    value[key] = new
    return new_from or (*walked, key)


def _key(value: Any, part: str | int, walked: list[str | int]) -> str | int:
    if isinstance(value, dict):
        return part
    if not isinstance(value, list):
        raise NeuroroboError(f"`{dotted(walked)}` is {value!r}, which has no `{part}`")
    if not str(part).isdecimal() or int(part) >= len(value):
        there_are = f"the indices 0 to {len(value) - 1}" if value else "no items"
        raise NeuroroboError(f"`{dotted(walked)}` is a list and has {there_are} (got '{part}')")
    return int(part)
