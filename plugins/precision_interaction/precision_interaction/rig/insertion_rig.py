"""The simulated insertion rig: its contact force is drawn from a law."""

import csv
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from neurorobo.bodies.body import Array
from neurorobo.errors import NeuroroboError
from precision_interaction.rig.contact import Contact, Law, Line, RandomContact, RecordedContact, Table
from precision_interaction.rig.insertion_body import InsertionBody
from precision_interaction.rig.insertion_rig_config import (
    ContactConfig,
    InsertionRigConfig,
    RecordedContactConfig,
    TableContactConfig,
)


class InsertionRig(InsertionBody):
    """Simulates Eq. 2: a radial move lowers the force by stiffness * move, axial travel in contact adds to it."""

    config: InsertionRigConfig

    def __init__(self, config: InsertionRigConfig) -> None:
        super().__init__(config)
        self._contact = build_contact(config)
        self.reset([])

    def reset(self, seeds: Sequence[int], which: NDArray[np.bool_] | None = None) -> None:
        """Bring all rigs, or those that `which` marks, to the start: `gap` apart, nothing moving, no force."""
        super().reset(seeds, which)
        if which is None:
            batch = len(seeds)
            which = np.ones(batch, dtype=np.bool_)
            self._generators = [np.random.default_rng()] * batch
            self._inserted_um: Array = np.zeros(batch)  # so far in this axial move
        for i, seed in zip(np.flatnonzero(which), seeds, strict=True):
            self._generators[i] = np.random.default_rng(seed)
        self._inserted_um[which] = 0.0

    def _force_after_mN(self, travel_um: Array, stage_um: Array, duration_ns: int) -> Array:
        gap_um = self.config.gap
        depth_um = np.maximum(self.travel_um - gap_um, 0.0)
        inserted_um = self._inserted_um + np.maximum(travel_um - gap_um, 0.0) - depth_um
        noise = np.array([generator.standard_normal(3) for generator in self._generators]).reshape(-1, 3)
        increment_mN = self._contact.increment_mN(self._inserted_um, inserted_um, depth_um, noise)
        self._inserted_um = np.where(self._ends_move(duration_ns), 0.0, inserted_um)
        increment_mN[:, :2] -= self._stiffness_mN_um() * (stage_um - self.stage_um)
        return np.asarray(self.force_mN + increment_mN)

    def _stiffness_mN_um(self) -> Array:
        """Return what a radial move of 1 um takes off now, (batch, 1)."""
        change = self.config.stiffness_change
        stiffness_mN_um = np.full((len(self.travel_um), 1), self.config.stiffness)
        if change is not None:
            stiffness_mN_um[self.travel_um >= change.at] = change.to
        return stiffness_mN_um


def build_contact(config: InsertionRigConfig) -> Contact:
    """Build the rig's contact; a NeuroroboError names a recorded file that cannot be read."""
    contact: ContactConfig = config.contact
    if isinstance(contact, RecordedContactConfig):
        return read_recording(Path(contact.file))
    law: Law
    if isinstance(contact, TableContactConfig):
        points = contact.points
        law = Table(tuple(p.distance for p in points), tuple(p.mean for p in points), tuple(p.variance for p in points))
    elif contact.law == "measured":
        law = Line(contact.mean_slope, contact.variance_slope, contact.mean_intercept, contact.variance_intercept)
    else:
        law = Line(contact.mean_slope, contact.variance_slope)
    r = contact.correlation
    correlation = np.array([[1.0, r.xy, r.xz], [r.xy, 1.0, r.yz], [r.xz, r.yz, 1.0]])
    return RandomContact(law, config.length, contact.depth_gain, correlation)


def read_recording(path: Path) -> RecordedContact:
    """Read a CSV file with the columns depth_um, force_x_mN, force_y_mN and, if recorded, force_z_mN.

    A NeuroroboError names the file, and the line where a number is missing or the depth does not rise.
    """
    depths: list[float] = []
    forces: list[tuple[float, float, float]] = []
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = csv.DictReader(file)
            missing = {"depth_um", "force_x_mN", "force_y_mN"} - set(rows.fieldnames or ())
            if missing:
                raise NeuroroboError(f"{path}: no column {', '.join(sorted(missing))} in its first line")
            for row in rows:
                place = f"{path}:{rows.line_num}"
                try:
                    depth = float(row["depth_um"])
                    x, y, z = float(row["force_x_mN"]), float(row["force_y_mN"]), float(row.get("force_z_mN") or 0.0)
                except (TypeError, ValueError):
                    depth = x = y = z = math.nan
                if not math.isfinite(depth + x + y + z):
                    raise NeuroroboError(f"{place}: not a finite number in every column; correct or remove the row")
                if depths and depth <= depths[-1]:
                    raise NeuroroboError(f"{place}: depth_um does not rise; sort the rows by it")
                depths.append(depth)
                forces.append((x, y, z))
    except (OSError, UnicodeDecodeError) as error:
        raise NeuroroboError(f"{path}: cannot be read ({error}); name a CSV file of a recorded insertion") from None
    if not depths:
        raise NeuroroboError(f"{path}: no rows; a recording needs at least one")
    return RecordedContact(tuple(depths), tuple(forces))
