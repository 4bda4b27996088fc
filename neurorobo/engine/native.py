"""Which path the engine takes: the native library built with the package, or torch alone, and why."""

import ctypes
import hashlib
import os
import platform
from dataclasses import dataclass
from functools import cache
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path
from typing import Literal

from neurorobo.errors import NeuroroboError

ENGINE_VARIABLE = "NEUROROBO_ENGINE"
"""`native` or `portable`; unset, native if it can be."""

INSTRUCTIONS_VARIABLE = "NEUROROBO_INSTRUCTIONS"
"""One of :data:`INSTRUCTION_SETS`; unset, the best that the processor has."""

INSTRUCTION_SETS = ("baseline", "avx2", "avx512")
"""From the plainest to the best; the number is what the library calls it."""

LIBRARIES_VARIABLE = "NEUROROBO_LIBRARIES"
"""The folder of the libraries, built with other flags; unset, those that were installed with the package."""

FOLDER = Path(__file__).parent

SOURCES = ("native.c", "models.h")
"""What a library is built from; `setup.py` has the same."""


@dataclass(frozen=True)
class EnginePath:
    """The path that the engine takes, why, and the instruction set of its library."""

    name: Literal["native", "portable"]
    reason: str
    instructions: str | None = None


def engine_path() -> EnginePath:
    """Return the path in use and why; raises a NeuroroboError if the environment asks for what there is not."""
    return _choose()[0]


def library() -> ctypes.CDLL | None:
    """Return the native library, or None on the portable path; raises as :func:`engine_path` does."""
    return _choose()[1]


@cache  # the environment is read once
def _choose() -> tuple[EnginePath, ctypes.CDLL | None]:
    engine, instructions = os.environ.get(ENGINE_VARIABLE, ""), os.environ.get(INSTRUCTIONS_VARIABLE, "")
    if engine not in ("", "native", "portable"):
        raise NeuroroboError(f"{ENGINE_VARIABLE} is `native`, `portable` or unset, not {engine!r}")
    if instructions not in ("", *INSTRUCTION_SETS):
        raise NeuroroboError(
            f"{INSTRUCTIONS_VARIABLE} is one of {', '.join(INSTRUCTION_SETS)} or unset, not {instructions!r}"
        )
    if engine == "portable":
        return EnginePath("portable", f"{ENGINE_VARIABLE}=portable"), None
    best, reason = _processor()
    if reason is None and instructions and INSTRUCTION_SETS.index(instructions) > best:
        reason = f"this processor has no {instructions}, which {INSTRUCTIONS_VARIABLE} asks for"
    if reason is None:
        for name in (instructions,) if instructions else reversed(INSTRUCTION_SETS[: best + 1]):
            loaded, reason = _load(name)
            if loaded is not None:
                why = (
                    f"{INSTRUCTIONS_VARIABLE}={name}" if instructions else "the best that was built for this processor"
                )
                if folder := os.environ.get(LIBRARIES_VARIABLE):
                    why += f", in {LIBRARIES_VARIABLE}={folder}"
                return EnginePath("native", why, name), loaded
    assert reason is not None
    if engine == "native" or instructions:
        raise NeuroroboError(f"the engine's native path was asked for, but {reason}")
    return EnginePath("portable", reason), None


def _processor() -> tuple[int, str | None]:
    """Return the number of the best instruction set of this processor, or what keeps the library from telling."""
    plain, fault = _load(INSTRUCTION_SETS[0])
    return (0, fault) if plain is None else (plain.neurorobo_processor(), None)


@cache
def _load(instructions: str) -> tuple[ctypes.CDLL | None, str | None]:
    """Return the library for one instruction set, or why there is none."""
    other = os.environ.get(LIBRARIES_VARIABLE)
    folder = Path(other) if other else FOLDER
    candidates = (folder / f"_native_{instructions}{suffix}" for suffix in EXTENSION_SUFFIXES)
    file = next((file for file in candidates if file.exists()), None)
    if file is None and other:
        return None, f"there is no library for {instructions} in {LIBRARIES_VARIABLE}={other}"
    if file is None:
        machine = f"{platform.system()} {platform.machine()}"
        return None, (
            f"neurorobo was installed without a library for {instructions} on {machine}: there was no C compiler, "
            "or it failed; install one and neurorobo again"
        )
    try:
        loaded = ctypes.CDLL(str(file))
        loaded.neurorobo_source.restype = ctypes.c_char_p
        built_from = loaded.neurorobo_source().decode()
    except (OSError, AttributeError) as error:
        return None, f"{file.name} cannot be loaded ({error}); install neurorobo again"
    sources = [FOLDER / name for name in SOURCES]
    if all(source.exists() for source in sources):
        now = hashlib.sha256(b"".join(source.read_bytes() for source in sources)).hexdigest()[:16]
        if built_from != now:
            return (
                None,
                f"{file.name} was built from another version of {' and '.join(SOURCES)}; install neurorobo again",
            )
    return loaded, None
