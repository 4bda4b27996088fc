"""What a result depends on: the source of a module, of all that it imports and of all that it names, and files."""

import ast
import hashlib
import re
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from neurorobo.engine import native
from neurorobo.plugins import Registry
from neurorobo.plugins.registry import KINDS

PACKAGES = ("neurorobo", "precision_interaction")


def fingerprint(
    module: str, files: Iterable[Path], words: Iterable[str] = (), without: frozenset[str] = frozenset()
) -> str:
    """Return a hash of a module's source, of all that it and the YAML files among ``files`` need, of the files, words.

    What is needed is what is imported, and what plugins registered under a name that stands there: `precision.law`.
    """
    digest = hashlib.sha256()
    named = {target for file in files if file.suffix == ".yaml" for target in _registered_in(file.read_text())}
    for name in sorted(modules(module, without).union(*(modules(each, without) for each in named))):
        digest.update(name.encode() + b"\0" + _content(name))
    for file in sorted(files):
        digest.update(file.name.encode() + b"\0" + file.read_bytes())
    for word in words:
        digest.update(word.encode() + b"\0")
    return digest.hexdigest()[:16]


@cache
def modules(module: str, without: frozenset[str] = frozenset()) -> frozenset[str]:
    """Return the names of a module and of all modules of `PACKAGES` that it needs, at whatever remove.

    Those in ``without`` are left out, and what they alone need.
    """
    found: set[str] = set()
    waiting = [module]
    while waiting:
        name = waiting.pop()
        if name in found or name in without:
            continue
        found.add(name)
        waiting += _needs(name)
    return frozenset(found)


def forget() -> None:
    """Read all sources anew for the next fingerprint."""
    modules.cache_clear()
    _needs.cache_clear()


@cache
def _needs(module: str) -> tuple[str, ...]:
    """Return the modules of `PACKAGES` that a module names in its imports, wherever they stand, and in its strings.

    Strings such as ``"rig.contact:Contact"``, with the package or without, are how plugins name what comes late, and
    ``"precision.law"`` is how YAML names what a plugin registers. What a docstring mentions is no need, nor is a
    plugin's own list of what it registers.
    """
    source = _source(module)
    return () if source is None else tuple(dict.fromkeys(_named(ast.parse(source.read_bytes()))))


def _named(tree: ast.AST) -> Iterator[str]:
    said = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if id(node) in said:
            continue
        candidates: list[str] = []
        if isinstance(node, ast.Import):
            candidates = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            candidates = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            target = node.value.partition(":")[0]
            candidates = [target, *(f"{package}.{target}" for package in PACKAGES)] if ":" in node.value else []
            candidates += _registered_in(node.value)
        for candidate in candidates:
            if candidate.split(".")[0] in PACKAGES and _source(candidate) is not None:
                yield candidate


def _registered_in(text: str) -> Iterator[str]:
    """Yield the modules of what a plugin of `PACKAGES` registered under a name that stands in a text."""
    for word in re.findall(r"[a-z]\w*(?:\.\w+)?", text):
        yield from _registered().get(word, ())


@cache
def _registered() -> Mapping[str, tuple[str, ...]]:
    """Return the modules of the types that bear a name, as it stands in YAML: the core's need no prefix."""
    registry, found = Registry.discover(), dict[str, tuple[str, ...]]()
    for entry in (entry for kind in KINDS if kind != "command" for entry in registry.entries(kind)):
        for name in {entry.name, entry.name.removeprefix("core.")}:
            found[name] = (*found.get(name, ()), entry.target.partition(":")[0])
    return found


def _content(module: str) -> bytes:
    source = _source(module)
    assert source is not None
    beside = [source.with_name(name) for name in native.SOURCES] if module == native.__name__ else []
    return b"".join(file.read_bytes() for file in (source, *beside))


@cache
def _source(module: str) -> Path | None:
    """Return the file of a module; None if there is no such module."""
    if not all(part.isidentifier() for part in module.split(".")):
        return None
    try:
        spec = find_spec(module)
    except (ImportError, ValueError):
        return None
    return None if spec is None or spec.origin is None or not spec.origin.endswith(".py") else Path(spec.origin)
