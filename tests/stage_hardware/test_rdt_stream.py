"""The measurement of a stream that loses records: it runs, and it is held to its figures."""

import json
import runpy
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "hardware" / "rdt_stream.py"


def test_every_loss_is_counted_and_none_made_up() -> None:
    command = [sys.executable, str(SCRIPT), "--seconds", "2", "--json"]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, timeout=60)
    found = json.loads(done.stdout)
    assert done.returncode == bool(found["misses"])
    assert found["sent"] > 1500 and found["dropped"] > 0
    assert found["read"] + found["counted_as_lost"] == found["sent"]
    assert 0 < found["of_one_processor"] < 0.5  # the machine may be slow


@pytest.mark.parametrize(
    ("more", "miss"),
    [
        ({}, None),
        ({"read": (1, 2, 3, 4, 5)}, "1 lost records have a reading"),
        ({"read": (1, 2, 5), "sent": 5}, "1 records were lost that the box has not dropped"),
        ({"lost": 2}, "2 losses are counted, not 1"),
        ({"read": (1, 4, 2, 5)}, "readings do not come in order, each once"),
        ({"is_load": False}, "a reading is not the load"),
        ({"processor_s": 1.5}, "reading takes 15.0% of a processor"),
    ],
)
def test_it_is_held_to_its_figures(more: dict[str, Any], miss: str | None) -> None:
    benchmark = runpy.run_path(str(SCRIPT))
    given = {"sent": 5, "read": (1, 2, 4, 5), "lost": 1, "is_load": True, "processor_s": 0.5, **more}
    counts = benchmark["RdtCounts"](len(given["read"]), given.pop("lost"), 0, 0, 0, 0)
    stream = benchmark["Stream"](dropped=frozenset({3}), counts=counts, wall_s=10.0, box_processor_s=1.0, **given)
    assert stream.misses()[:1] == ([miss] if miss else [])
