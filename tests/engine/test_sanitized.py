"""The native path under the address and undefined-behaviour sanitizers: its tests once more, on a build that checks."""

import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

from neurorobo.engine import native
from tests.engine.paths import CI

PROJECT = Path(__file__).parents[2]
FLAGS = ["-O1", "-g", "-std=c11", "-ffp-contract=off", "-fPIC", "-shared", "-pthread", "-fno-omit-frame-pointer"]
SANITIZERS = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
PROGRAM = """
import sys
from pathlib import Path
import pytest
from neurorobo.engine import native
native.FOLDER = Path(sys.argv[1])
sys.exit(pytest.main(["-q", "-s", "-p", "no:cacheprovider", "tests/engine/test_native.py"]))
"""


def test_no_kernel_reads_or_writes_what_is_not_its_own(tmp_path: Path) -> None:
    compiler = shutil.which(os.environ.get("CC", "cc"))
    found = [] if compiler is None else [_file(compiler, name) for name in ("libasan.so", "libstdc++.so")]
    if not found or not all(os.path.isabs(file) for file in found):
        reason = "no C compiler with an address sanitizer (CC, or cc)"
        if CI:
            pytest.fail(reason)
        pytest.skip(reason)
    library = tmp_path / f"_native_baseline{sysconfig.get_config_var('EXT_SUFFIX')}"
    source = str(native.FOLDER / "native.c")
    subprocess.run([str(compiler), *FLAGS, *SANITIZERS, source, "-o", str(library)], check=True)
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(tmp_path)],
        cwd=PROJECT,
        env={
            **os.environ,
            "LD_PRELOAD": " ".join(found),  # the second for the exceptions that torch throws and catches
            "ASAN_OPTIONS": "detect_leaks=0",  # Python's own
            "NEUROROBO_INSTRUCTIONS": "baseline",
        },
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    assert done.returncode == 0, done.stdout
    assert " passed" in done.stdout


def _file(compiler: str, name: str) -> str:
    """Return where the compiler keeps a library, or its bare name if it has none."""
    asked = [compiler, f"-print-file-name={name}"]
    return subprocess.run(asked, capture_output=True, text=True, check=True).stdout.strip()
