"""The log of an identification: how much force each of many insertions added, as CSV or Parquet."""

import csv
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from neurorobo.errors import NeuroroboError
from neurorobo.files import write_whole

Array = NDArray[np.float64]

STEP = "step_um"
INCREMENTS = ("increment_x_mN", "increment_y_mN", "increment_z_mN")
REQUIRED = (STEP, *INCREMENTS[:2])
UNIT_OF = {name: name.rpartition("_")[2] for name in (STEP, *INCREMENTS)}
LEAST_REPETITIONS = 10
"""Of a step: the variance of so few insertions is known to about a half."""

LARGEST = 1e6
"""1 kN, or 1 m: what is larger is no force and no step of an insertion, but a fault of the log."""

SEPARATORS = {";": "semicolons", "\t": "tabs", "|": "bars"}
"""What other programs write between columns, and how it is called."""


@dataclass(frozen=True)
class ContactLog:
    """Insertions by the commanded step ``step_um`` (n,), and the force ``increment_mN`` (n, 2 or 3) that each added.

    ``source`` names where they come from, and ``place`` where in it an insertion stands, by its number from 0. Every
    step has at least ``LEAST_REPETITIONS``.
    """

    step_um: Array
    increment_mN: Array
    source: str
    place: Callable[[int], str] = field(default=lambda row: f"row {row + 1}", compare=False, repr=False)

    def __post_init__(self) -> None:
        """Refuse a log without enough repetitions; a NeuroroboError names the source and the step."""
        if not len(self.step_um):
            raise NeuroroboError(f"{self.source}: no rows; log at least {LEAST_REPETITIONS} insertions of each step")
        for step, count in zip(*np.unique(self.step_um, return_counts=True), strict=True):
            if count < LEAST_REPETITIONS:
                few = "1 insertion" if count == 1 else f"{count} insertions"
                raise NeuroroboError(
                    f"{self.source}: {few} of {step:g} um, too few for a variance; log at least {LEAST_REPETITIONS} of "
                    "each step, under the step that was commanded"
                )

    @property
    def steps_um(self) -> Array:
        """The different steps, rising."""
        return np.unique(self.step_um)

    def of(self, step_um: float) -> Array:
        """Return the increments (n, axes) of the insertions of one step."""
        return np.asarray(self.increment_mN[self.step_um == step_um])


def read_log(path: Path) -> ContactLog:
    """Read a log: a row for each insertion, with the columns ``step_um``, ``increment_x_mN``, ``increment_y_mN``.

    ``increment_z_mN`` may be there or not; further columns are left alone. Parquet by its suffix, otherwise CSV. A
    NeuroroboError names the file, the column or line, what is wrong and what to do.
    """
    try:
        if path.suffix == ".parquet":
            names, columns, place = _read_parquet(path)
        else:
            names, columns, place = _read_csv(path)
    except (OSError, UnicodeDecodeError, csv.Error, ValueError) as error:
        raise NeuroroboError(f"{path}: cannot be read ({error}); name a CSV or Parquet file of insertions") from None
    numbers = np.empty((len(next(iter(columns.values()))), len(names)))
    for i, name in enumerate(names):
        for row, value in enumerate(columns[name]):
            numbers[row, i] = _number(value, f"{path}{place(row)}: {name}")
    log = ContactLog(numbers[:, 0], numbers[:, 1:], str(path), lambda row: f"{path}{place(row)}")
    if (wrong := np.flatnonzero(numbers[:, 0] <= 0)).size:
        raise NeuroroboError(
            f"{path}{place(int(wrong[0]))}: {STEP} is {numbers[wrong[0], 0]:g}; log insertions only, as lengths above 0"
        )
    return log


def write_log(log: ContactLog, path: Path) -> None:
    """Write a log as CSV, to the last digit."""
    text = StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([STEP, *INCREMENTS[: log.increment_mN.shape[1]]])
    writer.writerows([step, *increment] for step, increment in zip(log.step_um, log.increment_mN, strict=True))
    write_whole(path, text.getvalue().encode())


_Columns = tuple[list[str], Mapping[str, Sequence[Any]], Callable[[int], str]]
"""The names of the columns to read, all columns, and how the place of a row is told."""


def _read_csv(path: Path) -> _Columns:
    with path.open(newline="", encoding="utf-8-sig") as file:
        reader = csv.DictReader(file)
        names = _wanted(path, reader.fieldnames or ())
        columns: dict[str, list[Any]] = {name: [] for name in names}
        lines = []
        for row in reader:
            lines.append(reader.line_num)
            for name in names:
                columns[name].append(row[name])
    return names, columns, lambda row: f":{lines[row]}"


def _read_parquet(path: Path) -> _Columns:
    import pyarrow.parquet

    with path.open("rb") as file:
        table = pyarrow.parquet.read_table(file)
    names = _wanted(path, table.column_names)
    for name in names:
        told = (table.schema.field(name).metadata or {}).get(b"unit", UNIT_OF[name].encode()).decode()
        if told != UNIT_OF[name]:
            raise NeuroroboError(f"{path}: the column {name} says that it is in {told}; convert it to {UNIT_OF[name]}")
    return names, {name: table[name].to_pylist() for name in names}, lambda row: f", row {row + 1}"


def _wanted(path: Path, found: Sequence[str]) -> list[str]:
    """Return the names of the columns to read; a NeuroroboError if one is missing or in another unit."""
    for name in (STEP, *INCREMENTS):
        stem, _, unit = name.rpartition("_")
        for other in found:
            if name not in found and re.fullmatch(rf"{stem}(_\w+)?", other):
                raise NeuroroboError(f"{path}: the column {other} is not in {unit}; convert it and call it {name}")
    if len(found) == 1 and (separator := next((sign for sign in SEPARATORS if sign in found[0]), None)):
        raise NeuroroboError(
            f"{path}: its columns are separated by {SEPARATORS[separator]}; save it with commas between the columns, "
            "and with points in decimals (1.5, not 1,5)"
        )
    if missing := [name for name in REQUIRED if name not in found]:
        raise NeuroroboError(
            f"{path}: no column {', '.join(missing)}; a log has a row for each insertion and the columns "
            f"{', '.join(REQUIRED)} and, if measured, {INCREMENTS[2]}; this one has "
            f"{', '.join(map(repr, found)) or 'none'}"
        )
    return [name for name in (STEP, *INCREMENTS) if name in found]


def _number(value: object, place: str) -> float:
    try:
        number = float(value)  # type: ignore[arg-type] # a TypeError is told below
    except (TypeError, ValueError):
        number = np.nan
    if not abs(number) < LARGEST:
        shown = "nothing" if value is None or value == "" else repr(value)
        wrong = f"beyond {LARGEST:.0f}" if np.isfinite(number) else "not a number"
        raise NeuroroboError(f"{place} is {shown}, {wrong}; correct or remove the row")
    return number
