"""What a result depends on: the source of a module, of the plugin, of all that they import, and files beside it."""

import ast
import hashlib
from collections.abc import Iterable, Iterator
from functools import cache
from importlib.util import find_spec
from pathlib import Path

PACKAGES = ("neurorobo", "precision_interaction")
NATIVE = "neurorobo.engine.native"
PLUGIN = "precision_interaction.plugin"
COMMAND = "precision_interaction.reproduce.command"


def fingerprint(module: str, files: Iterable[Path], words: Iterable[str] = ()) -> str:
    """Return a hash of a module's source, of all that it imports, of some files and of some words."""
    digest = hashlib.sha256()
    for name in sorted(modules(module) | modules(PLUGIN)):
        digest.update(name.encode() + b"\0" + _content(name))
    for file in sorted(files):
        digest.update(file.name.encode() + b"\0" + file.read_bytes())
    for word in words:
        digest.update(word.encode() + b"\0")
    return digest.hexdigest()[:16]


@cache
def modules(module: str) -> frozenset[str]:
    """Return the names of a module and of all modules of `PACKAGES` that it imports, at whatever remove.

    The command that measures is left out, or all rows would depend on one another.
    """
    found: set[str] = set()
    waiting = [module]
    while waiting:
        name = waiting.pop()
        if name in found:
            continue
        found.add(name)
        waiting += _imports(name)
    return frozenset(found)


@cache
def _imports(module: str) -> tuple[str, ...]:
    """Return the modules of `PACKAGES` that a module names in its imports, wherever they stand, and in its strings.

    Strings such as ``"rig.contact:Contact"``, with the package or without, are how plugins name what comes late.
    """
    source = _source(module)
    return () if source is None else tuple(dict.fromkeys(_named(ast.parse(source.read_bytes()))))


def _named(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        candidates: list[str] = []
        if isinstance(node, ast.Import):
            candidates = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            candidates = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and ":" in node.value:
            target = node.value.partition(":")[0]
            candidates = [target, *(f"{package}.{target}" for package in PACKAGES)]
        for candidate in candidates:
            if candidate != COMMAND and candidate.split(".")[0] in PACKAGES and _source(candidate) is not None:
                yield candidate


def _content(module: str) -> bytes:
    source = _source(module)
    assert source is not None
    beside = source.with_suffix(".c").read_bytes() if module == NATIVE else b""
    return source.read_bytes() + beside


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
