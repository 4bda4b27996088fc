"""Running the engine on a path of the test's choice."""

import os
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from neurorobo.engine import engine_path, native

CI = os.environ.get("CI") == "true"


@contextmanager
def engine(path: str, instructions: str = "") -> Iterator[None]:
    """Let the engine take one path, with one instruction set or the best."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(native.ENGINE_VARIABLE, path)
        patch.setenv(native.INSTRUCTIONS_VARIABLE, instructions)
        native._choose.cache_clear()
        try:
            yield
        finally:
            patch.undo()
            native._choose.cache_clear()


INSTALLED = pytest.mark.skipif(
    native.LIBRARIES_VARIABLE in os.environ, reason="libraries built with other flags take their own time and memory"
)
"""For tests of the time or the memory that the installed libraries take."""


def missing() -> str | None:
    """Return why the native path cannot be tested here."""
    with engine(""):
        path = engine_path()
    return None if path.name == "native" else path.reason


def instruction_sets() -> list[str]:
    """Return those that were built and that this processor has."""
    found = []
    for name in native.INSTRUCTION_SETS:
        try:
            with engine("native", name):
                engine_path()
        except native.NeuroroboError:
            continue
        found.append(name)
    return found


def needs_native() -> pytest.MarkDecorator:
    """Skip, and say why, where there is no native library; fail on the servers that check every change."""
    why = missing()
    if why is not None and CI:
        raise RuntimeError(f"the native path must be tested here, but {why}")
    return pytest.mark.skipif(why is not None, reason=f"no native engine: {why}")
