"""The simulated insertion rig: an axial elevator, a radial stage and a force sensor, many rigs side by side."""

import csv
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from neurorobo.bodies.body import Array, Body
from neurorobo.errors import NeuroroboError
from neurorobo.units import format_duration
from precision_interaction.rig.contact import Contact, Law, Line, RandomContact, RecordedContact, Table
from precision_interaction.rig.insertion_rig_config import (
    ContactConfig,
    InsertionRigConfig,
    RecordedContactConfig,
    TableContactConfig,
)


class InsertionRig(Body):
    """Simulates Eq. 2: a radial move lowers the force by stiffness * move, axial travel in contact adds to it.

    `force_mN` (batch, 3) is the true force, `travel_um` (batch,) and `stage_um` (batch, 2) the true positions; `read`
    reports them in the sensors' counts. An axial speed is held and cut into moves of `axial_period`.
    """

    config: InsertionRigConfig

    def __init__(self, config: InsertionRigConfig) -> None:
        super().__init__(config)
        self.config = config
        self._contact = build_contact(config)
        self.reset([])

    def reset(self, seeds: Sequence[int], which: NDArray[np.bool_] | None = None) -> None:
        """Bring all rigs, or those that `which` marks, to the start: `gap` apart, nothing moving, no force."""
        if which is None:
            batch = len(seeds)
            which = np.ones(batch, dtype=np.bool_)
            self._generators = [np.random.default_rng()] * batch
            self.force_mN: Array = np.zeros((batch, 3))
            self.stage_um: Array = np.zeros((batch, 2))
            self.travel_um: Array = np.zeros(batch)
            self._ideal_um: Array = np.zeros(batch)  # where the elevator would be without its resolution
            self._inserted_um: Array = np.zeros(batch)  # so far in this axial move
            self._speed_um_s: Array = np.zeros(batch)
            self._last_speed_um_s: Array = np.zeros(batch)  # in the axial move before this one
            self._elapsed_ns: NDArray[np.int64] = np.zeros(batch, dtype=np.int64)  # in this axial move
        for i, seed in zip(np.flatnonzero(which), seeds, strict=True):
            self._generators[i] = np.random.default_rng(seed)
        for values in (
            self.force_mN,
            self.stage_um,
            self.travel_um,
            self._ideal_um,
            self._inserted_um,
            self._speed_um_s,
        ):
            values[which] = 0.0
        self._last_speed_um_s[which] = self.config.creep_speed
        self._elapsed_ns[which] = 0

    def read(self) -> dict[str, Array]:
        """Return the radial force, the axial distances and the radial position."""
        range_mN = self.config.force_range
        force_mN = _rounded(self.force_mN[:, :2], self.config.force_resolution)
        return {
            "force": np.clip(force_mN, range_mN.lo, range_mN.hi),
            "remaining": (self.config.length - self.travel_um)[:, None],
            "travel": self.travel_um[:, None].copy(),
            "stage": self.stage_um.copy(),
        }

    def limits(self, duration_ns: int) -> dict[str, tuple[Array, Array]]:
        """Return what may be commanded now, (batch, width) arrays; the same for every duration within an axial period.

        The axial speed stays between creep and maximum and within the acceleration limit of the speed before; a
        move that would pass the end is shortened, whatever the other limits say.
        """
        config = self.config
        period_s = config.axial_period * 1e-9
        left_s = (config.axial_period - self._elapsed_ns) * 1e-9
        # An elevator that rounds its position cannot end two moves closer to their plan than this.
        change = config.max_acceleration * period_s + config.elevator_resolution / period_s
        lo = np.maximum(self._last_speed_um_s - change, config.creep_speed)
        hi = np.minimum(self._last_speed_um_s + change, config.max_speed)
        within = np.maximum(config.length - self._ideal_um, 0.0) / left_s
        axial = (np.minimum(lo, within)[:, None], np.minimum(hi, within)[:, None])
        return {**super().limits(duration_ns), "axial_speed": axial}

    @property
    def between_moves(self) -> NDArray[np.bool_]:
        """Whether each rig (batch) has just ended an axial move, or has not begun one."""
        return np.asarray(self._elapsed_ns == 0)

    def advance(self, commands: Mapping[str, Array], duration_ns: int) -> None:
        """Move for `duration_ns`; a NeuroroboError if that reaches beyond the end of the present axial period."""
        config = self.config
        if (self._elapsed_ns + duration_ns > config.axial_period).any():
            raise NeuroroboError(
                f"body: a motion of {format_duration(duration_ns)} does not fit into axial moves of "
                f"{format_duration(config.axial_period)}; let `body.axial_period` be a multiple of every period"
            )
        if "axial_speed" in commands:
            self._speed_um_s = np.array(commands["axial_speed"][:, 0], dtype=np.float64)
        stiffness_mN_um = self._stiffness_mN_um()
        increment_mN = self._insert(duration_ns)
        if "radial_move" in commands:
            target_um = _rounded(self.stage_um + commands["radial_move"], config.stage_resolution)
            increment_mN[:, :2] -= stiffness_mN_um * (target_um - self.stage_um)
            self.stage_um = target_um
        self.force_mN = self.force_mN + increment_mN

    def stop(self) -> None:
        """Stand still."""
        self._speed_um_s = np.zeros_like(self._speed_um_s)

    def _stiffness_mN_um(self) -> Array:
        """Return what a radial move of 1 um takes off now, (batch, 1)."""
        change = self.config.stiffness_change
        stiffness_mN_um = np.full((len(self.travel_um), 1), self.config.stiffness)
        if change is not None:
            stiffness_mN_um[self.travel_um >= change.at] = change.to
        return stiffness_mN_um

    def _insert(self, duration_ns: int) -> Array:
        """Travel on and return the contact force (batch, 3) that this adds."""
        config = self.config
        before_um = self.travel_um
        self._ideal_um = self._ideal_um + self._speed_um_s * (duration_ns * 1e-9)
        travel_um = _rounded(self._ideal_um, config.elevator_resolution)
        # Rounding alone, of floats or to the resolution, never carries the elevator past the end.
        within = self._ideal_um <= config.length + 1e-6
        self.travel_um = np.where(within, np.minimum(travel_um, config.length), travel_um)
        depth_um = np.maximum(before_um - config.gap, 0.0)
        inserted_um = self._inserted_um + np.maximum(self.travel_um - config.gap, 0.0) - depth_um
        noise = np.array([generator.standard_normal(3) for generator in self._generators]).reshape(-1, 3)
        increment_mN = self._contact.increment_mN(self._inserted_um, inserted_um, depth_um, noise)
        self._elapsed_ns = (self._elapsed_ns + duration_ns) % config.axial_period
        ended = self.between_moves
        self._inserted_um = np.where(ended, 0.0, inserted_um)
        # The next axial move starts where this one really ended.
        self._ideal_um = np.where(ended, self.travel_um, self._ideal_um)
        self._last_speed_um_s = np.where(ended, self._speed_um_s, self._last_speed_um_s)
        return increment_mN


def _rounded(values: Array, resolution: float) -> Array:
    return np.round(values / resolution) * resolution if resolution > 0 else values


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
