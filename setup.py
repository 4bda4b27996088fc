"""Build the engine's native path with the package, once per instruction set.

All builds are optional: where there is no C compiler, or one that does not know an instruction set, the package
installs without them, and the engine runs in torch.
"""

import hashlib
import platform
from pathlib import Path

from setuptools import Extension, setup

ENGINE = Path("neurorobo", "engine")
SOURCES = ("native.c", "models.h")
FLAGS = ["-O3", "-std=c11", "-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math", "-pthread", "-g0"]
X86 = {
    "avx512": ["-mavx512f", "-mavx512dq", "-mavx512bw", "-mavx512vl", "-mprefer-vector-width=512"],
    "avx2": ["-mavx2"],
}
INSTRUCTION_SETS = {**(X86 if platform.machine().lower() in ("x86_64", "amd64") else {}), "baseline": []}

here = Path(__file__).parent / ENGINE
source_hash = hashlib.sha256(b"".join((here / name).read_bytes() for name in SOURCES))

setup(
    ext_modules=[
        Extension(
            f"neurorobo.engine._native_{name}",
            [str(ENGINE / SOURCES[0])],
            define_macros=[("NEUROROBO_SOURCE", f'"{source_hash.hexdigest()[:16]}"')],
            extra_compile_args=[*FLAGS, *flags],
            extra_link_args=["-pthread"],
            depends=["setup.py", *(str(ENGINE / name) for name in SOURCES[1:])],
            optional=True,
        )
        for name, flags in INSTRUCTION_SETS.items()
    ]
)
