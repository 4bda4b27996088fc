"""A YAML 1.2 document that remembers where each of its values stands."""

import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import yaml
from yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode

from neurorobo.errors import ConfigError, Fault

MOST_VALUES = 100_000
"""The most values of a document, each use of an anchor counted; it stops anchors that multiply one another."""

DocumentPath = tuple[str | int, ...]
Mark = tuple[int, int]


@dataclass(frozen=True)
class Document:
    """The content of a file, and where it comes from: lines and columns count from 1, overrides win over the file."""

    source: str
    text: str = field(repr=False)
    value: Any
    marks: dict[DocumentPath, Mark] = field(repr=False)
    overrides: tuple[tuple[DocumentPath, str], ...] = ()

    def mark(self, path: DocumentPath) -> Mark:
        """Return line and column of the key or list item at ``path``, or of the nearest one above it that exists."""
        while path not in self.marks:
            path = path[:-1]
        return self.marks[path]

    def place(self, path: DocumentPath) -> str:
        """Return ``file:line:column``, with the overrides that changed a part of it, or the one that set it all."""
        if self._override(path) is not None:
            return f"--set {self.overrides_at(path)[0]}"
        line, column = self.mark(path)
        return f"{self.source}:{line}:{column}" + "".join(f" with --set {text}" for text in self.overrides_at(path))

    def overrides_at(self, path: DocumentPath) -> list[str]:
        """Return the override that set what lies at a path, or those that changed a part of it."""
        index = self._override(path)
        if index is not None:
            return [self.overrides[index][1]]
        return list({place: text for place, text in self.overrides if place[: len(path)] == path}.values())

    def folder(self, path: DocumentPath) -> Path:
        """Return what a relative path at ``path`` starts from: the file's folder, or where an override was typed."""
        return Path(self.source).parent if self._override(path) is None else Path.cwd()

    def order(self, path: DocumentPath) -> tuple[int, int, int]:
        """Return a key that sorts faults by their place, the overrides' last."""
        index = self._override(path)
        return (0, *self.mark(path)) if index is None else (1, index, 0)

    def overridden(self, value: Any, path: DocumentPath, text: str) -> "Document":
        """Return the document with a new value, of which ``text`` (``a.b=c``) has set what lies at ``path``."""
        return replace(self, value=value, overrides=(*self.overrides, (path, text)))

    def _override(self, path: DocumentPath) -> int | None:
        """Return which override set what lies at a path or, where the file has nothing, a part of it or beside it."""
        set_it = [index for index, (place, _) in enumerate(self.overrides) if path[: len(place)] == place]
        while not set_it and path not in self.marks:
            set_it = [index for index, (place, _) in enumerate(self.overrides) if place[: len(path)] == path]
            path = path[:-1]
        return set_it[-1] if set_it else None


def load_document(path: str | Path) -> Document:
    """Read a YAML file; a ConfigError if it cannot be read, is not UTF-8, not YAML, empty or not a mapping."""
    source = str(path)
    try:
        text = Path(path).read_bytes().decode("utf-8-sig")
    except FileNotFoundError:
        raise _error(source, None, "there is no such file") from None
    except OSError as error:
        raise _error(source, None, f"cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        before, byte = error.object[: error.start].decode(), error.object[error.start]
        message = f"is not text in UTF-8: there is a byte 0x{byte:02x}; save the file as UTF-8"
        raise _error(source, _end(before), message) from None
    return parse_document(text, source)


def parse_document(text: str, source: str) -> Document:
    """Read a YAML mapping; ``source`` is its name in messages."""
    node = _compose(text, source)
    if node is None:
        raise _error(source, None, "is empty; an experiment starts with 'neurorobo: 1'")
    if not isinstance(node, MappingNode):
        wrong = "list" if isinstance(node, SequenceNode) else "single value"
        raise _error(source, _mark(node), f"is a {wrong}, not a mapping; an experiment starts with 'neurorobo: 1'")
    reader = _Reader(source)
    value = reader.read(node)
    return Document(source, text, value, reader.marks)


def parse_value(text: str, source: str) -> Any:
    """Read a YAML value of any kind; nothing at all is null."""
    node = _compose(text, source)
    return None if node is None else _Reader(source).read(node)


def dump(value: Any) -> str:
    """Return plain values as YAML that reads back to the same, keys in their order."""
    text: str = yaml.dump(value, Dumper=_Dumper, sort_keys=False, width=120)
    return text


class _Loader(yaml.BaseLoader):
    """Resolves plain scalars as YAML 1.2 does: `1e-3` is a number, `on` and `no` are text, `010` is ten."""


class _Dumper(yaml.SafeDumper):
    """Quotes every text that either version of YAML would take for something else."""


for _tag, _pattern in {
    "null": r"~|null|Null|NULL|",
    "bool": r"true|True|TRUE|false|False|FALSE",
    "int": r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+",
    "float": r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)",
}.items():
    for _class in (_Loader, _Dumper):
        _class.add_implicit_resolver(f"tag:yaml.org,2002:{_tag}", re.compile(rf"^(?:{_pattern})$"), None)


def _scalar(node: ScalarNode) -> str | int | float | bool | None:
    text: str = node.value
    match node.tag.removeprefix("tag:yaml.org,2002:"):
        case "str":
            return text
        case "null":
            return None
        case "bool":
            return text.lower() == "true"
        case "int":
            return int(text, {"0o": 8, "0x": 16}.get(text[:2], 10))
        case "float":
            return float(text.lower().replace(".inf", "inf").replace(".nan", "nan"))
        case _:
            raise ValueError(f"the tag '{node.tag}' is not allowed")


@dataclass
class _Reader:
    """Turns nodes into plain values that share nothing, noting the mark of each."""

    source: str
    marks: dict[DocumentPath, Mark] = field(default_factory=lambda: {(): (1, 1)})
    faults: list[Fault] = field(default_factory=list)
    lines: list[str] = field(default_factory=list)
    values: int = 0

    def read(self, node: Node) -> Any:
        """Return the value of the root; a ConfigError with every fault in it."""
        try:
            value = self._value(node, ())
        except RecursionError:
            raise _error(self.source, None, "is nested too deeply, or an anchor contains itself") from None
        if self.faults:
            raise ConfigError(self.faults, self.lines)
        return value

    def _value(self, node: Node, path: DocumentPath) -> Any:
        self.values += 1
        if self.values > MOST_VALUES:
            raise _error(
                self.source, _mark(node), f"holds more than {MOST_VALUES} values, each use of an anchor counted"
            )
        if isinstance(node, MappingNode):
            return {key: self._value(child, (*path, key)) for key, child in self._items(node, path)}
        if isinstance(node, SequenceNode):
            for index, child in enumerate(node.value):
                self.marks[*path, index] = _mark(child)
            return [self._value(child, (*path, index)) for index, child in enumerate(node.value)]
        assert isinstance(node, ScalarNode)
        try:
            return _scalar(node)
        except ValueError as error:
            self._fault(node, path, str(error))
            return None

    def _items(self, node: MappingNode, path: DocumentPath) -> Iterator[tuple[str, Node]]:
        first: dict[str, Node] = {}
        for key_node, child in node.value:
            key = _scalar(key_node) if isinstance(key_node, ScalarNode) else None
            if not isinstance(key, str):
                shown = key_node.value if isinstance(key_node, ScalarNode) else "a list or mapping"
                self._fault(key_node, path, f"a key must be text (got {shown}); put it in quotes")
            elif key == "<<" and key_node.style is None:
                self._fault(key_node, path, "YAML 1.2 has no merge key '<<'; write the keys out")
            elif key in first:
                line, _ = _mark(first[key])
                self._fault(key_node, (*path, key), f"duplicate key `{key}` (first at line {line}); remove one of them")
            else:
                first[key] = key_node
                self.marks[*path, key] = _mark(key_node)
                yield key, child

    def _fault(self, node: Node, path: DocumentPath, message: str) -> None:
        fault = Fault(path, message)
        line, column = _mark(node)
        self.faults.append(fault)
        self.lines.append(f"{self.source}:{line}:{column}: {fault}")


def _compose(text: str, source: str) -> Node | None:
    try:
        return yaml.compose(text, _Loader)
    except yaml.MarkedYAMLError as error:
        raise _not_yaml(text, source, error) from None
    except yaml.reader.ReaderError as error:
        message = f"is not valid YAML: the character {chr(error.character)!r} is not allowed"
        raise _error(source, _end(text[: error.position]), message) from None
    except RecursionError:
        raise _error(source, None, "is nested too deeply") from None


def _not_yaml(text: str, source: str, error: yaml.MarkedYAMLError) -> ConfigError:
    """Return what is wrong where it begins: the parser notices what is not closed only later."""
    quote = _unclosed_quote(text, error)
    if quote is not None:
        return _error(source, _place(quote), "is not valid YAML: a quote opens here that is not closed; close it")
    mark = error.problem_mark or error.context_mark
    context = f" {error.context}" if error.context else ""
    if "flow" in context and error.context_mark:
        context += ", which opens at {}:{}".format(*_place(error.context_mark))
    return _error(source, _place(mark) if mark else None, f"is not valid YAML: {error.problem}{context}")


def _unclosed_quote(text: str, error: yaml.MarkedYAMLError) -> yaml.Mark | None:
    """Return where a quote opens that nothing closes, or nothing but the next one, lines below, which was to open."""
    if error.context == "while scanning a quoted scalar":
        return error.context_mark
    with suppress(yaml.YAMLError):
        for token in yaml.scan(text, _Loader):
            ends_at_problem = error.problem_mark and token.end_mark.index == error.problem_mark.index
            if isinstance(token, yaml.ScalarToken) and not token.plain and ends_at_problem:
                return token.start_mark if token.start_mark.line < token.end_mark.line else None
    return None


def _mark(node: Node) -> Mark:
    return _place(node.start_mark)


def _place(mark: yaml.Mark) -> Mark:
    return mark.line + 1, mark.column + 1


def _end(text: str) -> Mark:
    """Return the place right after a text."""
    return text.count("\n") + 1, len(text) - text.rfind("\n")


def _error(source: str, mark: Mark | None, message: str) -> ConfigError:
    line, column = mark or (1, 1)
    return ConfigError([Fault((), message)], [f"{source}:{line}:{column}: {message}"])
