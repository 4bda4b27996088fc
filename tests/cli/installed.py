"""Plugins that are installed for one test."""

import sys
from pathlib import Path

import pytest


def install_plugin(folder: Path, monkeypatch: pytest.MonkeyPatch, prefix: str, plugin: str) -> None:
    """Leave a distribution with one plugin, of the text ``plugin``, on the path."""
    monkeypatch.syspath_prepend(str(folder))
    (folder / f"{prefix}_nr.py").write_text(plugin)
    info = folder / f"{prefix}_nr-0.2.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {prefix}-nr\nVersion: 0.2\n")
    (info / "entry_points.txt").write_text(f"[neurorobo.plugins]\n{prefix} = {prefix}_nr\n")
    monkeypatch.delitem(sys.modules, f"{prefix}_nr", raising=False)
