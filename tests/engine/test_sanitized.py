"""That `make sanitize` checks what it promises: the libraries in use stop at the first step beyond their memory."""

import os
import subprocess
import sys

import pytest

from neurorobo.engine import native
from tests.engine.paths import instruction_sets

pytestmark = pytest.mark.skipif(
    native.LIBRARIES_VARIABLE not in os.environ, reason="the installed libraries do not check themselves: make sanitize"
)

PROGRAM = """
import torch
from neurorobo.engine.kernels import kernels
found, spikes, weights = kernels(), torch.zeros(2, 1, 64), torch.zeros(8, 8)
words = torch.empty(1, 1, 1, dtype=torch.int64)
"""


@pytest.mark.parametrize("instructions", instruction_sets())
@pytest.mark.parametrize(
    ("mistake", "words"),
    [
        (
            "found._pack_spikes(spikes.data_ptr(), 2, 1, 64, 64, 64, words.data_ptr())",
            "AddressSanitizer: heap-buffer-overflow",
        ),
        ("found._pack_weights(weights.data_ptr() + 1, 8, 7, weights.data_ptr())", "runtime error: load of misaligned"),
    ],
    ids=["address", "undefined behaviour"],
)
def test_a_mistake_stops_the_program(instructions: str, mistake: str, words: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM + mistake],
        env={**os.environ, native.ENGINE_VARIABLE: "native", native.INSTRUCTIONS_VARIABLE: instructions},
        capture_output=True,
        text=True,
    )
    assert done.returncode != 0
    assert words in done.stderr
    assert f"_native_{instructions}" in done.stderr or "native.c" in done.stderr
