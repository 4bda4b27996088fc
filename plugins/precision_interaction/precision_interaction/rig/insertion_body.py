"""Insertion bodies: an axial elevator, a radial stage and a force sensor, many of them side by side."""

from abc import abstractmethod
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from neurorobo.bodies.body import Array, Body
from neurorobo.errors import NeuroroboError
from neurorobo.units import format_duration
from precision_interaction.rig.insertion_body_config import InsertionBodyConfig


class InsertionBody(Body):
    """Moves elevator and stage as commanded; what force that makes is told by the body derived from it.

    `force_mN` (batch, 3) is the true force, `travel_um` (batch,) and `stage_um` (batch, 2) the true positions; `read`
    reports them in the sensors' counts. An axial speed is held and cut into moves of `axial_period`.
    """

    config: InsertionBodyConfig

    def __init__(self, config: InsertionBodyConfig) -> None:
        super().__init__(config)
        self.config = config

    def reset(self, seeds: Sequence[int], which: NDArray[np.bool_] | None = None) -> None:
        """Bring all bodies, or those that `which` marks, to the start: `gap` apart, nothing moving, no force."""
        if which is None:
            batch = len(seeds)
            which = np.ones(batch, dtype=np.bool_)
            self.force_mN: Array = np.zeros((batch, 3))
            self.stage_um: Array = np.zeros((batch, 2))
            self.travel_um: Array = np.zeros(batch)
            self._ideal_um: Array = np.zeros(batch)  # where the elevator would be without its resolution
            self._speed_um_s: Array = np.zeros(batch)
            self._last_speed_um_s: Array = np.zeros(batch)  # in the axial move before this one
            self._elapsed_ns: NDArray[np.int64] = np.zeros(batch, dtype=np.int64)  # in this axial move
        for values in (self.force_mN, self.stage_um, self.travel_um, self._ideal_um, self._speed_um_s):
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
        """Whether each body (batch) has just ended an axial move, or has not begun one."""
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
        ideal_um = self._ideal_um + self._speed_um_s * (duration_ns * 1e-9)
        travel_um = _rounded(ideal_um, config.elevator_resolution)
        # Rounding alone, of floats or to the resolution, never carries the elevator past the end.
        within = ideal_um <= config.length + 1e-6
        travel_um = np.where(within, np.minimum(travel_um, config.length), travel_um)
        stage_um = self.stage_um
        if "radial_move" in commands:
            stage_um = _rounded(self.stage_um + commands["radial_move"], config.stage_resolution)
        self.force_mN = self._force_after_mN(travel_um, stage_um, duration_ns)
        self.travel_um, self.stage_um = travel_um, stage_um
        ended = self._ends_move(duration_ns)
        self._elapsed_ns = (self._elapsed_ns + duration_ns) % config.axial_period
        # The next axial move starts where this one really ended.
        self._ideal_um = np.where(ended, travel_um, ideal_um)
        self._last_speed_um_s = np.where(ended, self._speed_um_s, self._last_speed_um_s)

    def stop(self) -> None:
        """Stand still."""
        self._speed_um_s = np.zeros_like(self._speed_um_s)

    @abstractmethod
    def _force_after_mN(self, travel_um: Array, stage_um: Array, duration_ns: int) -> Array:
        """Return the true force (batch, 3) once elevator (batch,) and stage (batch, 2) have moved there.

        They set out together from `travel_um` and `stage_um`, and arrive together after `duration_ns`.
        """

    def _ends_move(self, duration_ns: int) -> NDArray[np.bool_]:
        """Return whether a motion of this duration, if it starts now, ends the axial move of each body (batch)."""
        return np.asarray(self._elapsed_ns + duration_ns == self.config.axial_period)


def _rounded(values: Array, resolution: float) -> Array:
    return np.round(values / resolution) * resolution if resolution > 0 else values
