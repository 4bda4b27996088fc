"""The results that are there: a file for each row, a cell on each line, each with the hash of what it depends on."""

import json
import os
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from neurorobo.errors import NeuroroboError
from precision_interaction.reproduce.dependencies import fingerprint, forget
from precision_interaction.reproduce.row import Result, Row, Setting


@dataclass
class Store:
    """The results of one row in ``folder``."""

    folder: Path
    row: Row
    setting: Setting
    kept: dict[str, dict[str, Any]] = field(init=False)
    commit: str = field(init=False)

    def __post_init__(self) -> None:
        """Read what there is; a NeuroroboError if it is damaged."""
        self.kept = {}
        self.commit = commit()
        if self.file.exists():
            try:
                self.kept = json.loads(self.file.read_text())["cells"]
            except (ValueError, KeyError, TypeError) as error:
                raise NeuroroboError(f"{self.file} is damaged ({error}); remove it to measure again") from None

    @property
    def file(self) -> Path:
        """Where the results are."""
        return self.folder / f"{self.row.name}.json"

    @cached_property
    def key(self) -> str:
        """The hash of what all cells depend on."""
        return self._fingerprint()

    def _fingerprint(self) -> str:
        row, setting = self.row, self.setting
        words = (row.name, "quick" if setting.quick else "full", *row.words(setting))
        return fingerprint(type(row).__module__, row.files(setting), words, row.bystanders)

    def missing(self) -> list[str]:
        """Return the cells that were not measured, or by other code or settings."""
        return [cell for cell in self.row.cells(self.setting) if self.kept.get(cell, {}).get("key") != self.key]

    @property
    def whole(self) -> bool:
        """Whether all cells were measured, by the same code and settings, these or others."""
        keys = {self.kept[cell]["key"] if cell in self.kept else None for cell in self.row.cells(self.setting)}
        return None not in keys and len(keys) == 1

    def results(self) -> dict[str, Result]:
        """Return the results of all cells by name; only when the row is whole."""
        return {cell: self.kept[cell]["result"] for cell in self.row.cells(self.setting)}

    def seconds(self) -> float:
        """Return the processor time of all cells together."""
        return float(sum(self.kept[cell]["seconds"] for cell in self.row.cells(self.setting)))

    def provenance(self) -> list[str]:
        """Return of which commits the results are."""
        return sorted({self.kept[cell]["commit"] for cell in self.row.cells(self.setting)})

    def add(self, cell: str, result: Result, seconds: float) -> None:
        """Keep a result, whole, whenever this is stopped; those of cells that are no more are dropped.

        Raises a NeuroroboError, and keeps nothing, if the code or a file has changed since this began.
        """
        forget()
        if self._fingerprint() != self.key:
            raise NeuroroboError(
                f"{self.row.name}, {cell}: the code, an example or weights changed while this was measured; which file "
                "it was cannot be told, and the cell is not kept; run this again"
            )
        self.kept[cell] = {"key": self.key, "seconds": round(seconds, 1), "commit": self.commit, "result": result}
        cells = [name for name in self.row.cells(self.setting) if name in self.kept]
        lines = ",\n  ".join(f"{json.dumps(name)}: {json.dumps(self.kept[name])}" for name in cells)
        self.folder.mkdir(parents=True, exist_ok=True)
        draft = self.file.with_suffix(".tmp")
        draft.write_text(f'{{"row": {json.dumps(self.row.name)}, "cells": {{\n  {lines}\n}}}}\n')
        os.replace(draft, self.file)


def commit() -> str:
    """Return the commit that is checked out here, marked if files differ from it; "unknown" without git."""
    try:
        found = subprocess.run(
            ["git", "describe", "--always", "--dirty", "--abbrev=10", "--exclude=*"],
            capture_output=True,
            text=True,
            check=True,
        )
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return found.stdout.strip()


def as_json(result: Mapping[str, Any]) -> Result:
    """Return a result as it will be read back, so that a fresh one and a kept one are the same."""
    parsed: Result = json.loads(json.dumps(result, allow_nan=False))
    return parsed
