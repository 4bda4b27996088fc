"""What the figures of all benchmarks depend on; a script that imports it puts this folder on its path."""

import os
import platform
import time
from pathlib import Path
from typing import Any

import torch

from neurorobo.engine import engine_path


def processor() -> str:
    """Return the processor's name."""
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text().splitlines() if cpuinfo.exists() else []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return models[0] if models else platform.processor()


def machine() -> dict[str, Any]:
    """Return what times depend on."""
    return {
        "processor": processor(),
        "cores": os.cpu_count(),
        "instructions": engine_path().instructions,
        "os": platform.platform(),
        "python": platform.python_version(),
        "torch": torch.__version__,
        "load": round(os.getloadavg()[0], 2),
        "date": time.strftime("%Y-%m-%d"),
    }
