"""The turntable: head and screen turn as the protocol says, the eye as it is commanded."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from neurorobo.bodies import Array, Body
from neurorobo_paradigms.vestibulo_ocular.turntable_config import TurntableConfig


class Turntable(Body):
    """Subjects side by side, each at its own time of the same protocol; velocities are in deg/s, each (batch,).

    The head turns with ``2 pi f A sin(2 pi f t)`` from the beginning of each phase on, the screen with ``1 - wanted
    gain`` of it, and the image slips by ``slip = wanted_gain * head - eye``. `read` tells the slip with its noise.
    Behind the last phase the head stands still in the dark.
    """

    def __init__(self, config: TurntableConfig) -> None:
        """Lay out the protocol; :meth:`reset` says how many subjects there are."""
        super().__init__(config)
        self.config = config
        phases = list(config.phases.values())
        self.names = tuple(config.phases)
        self._ends_ns = np.cumsum([phase.duration_ns for phase in phases])
        self._begins_ns = np.append(0, self._ends_ns)
        self._frequency_Hz = np.array([*(phase.frequency for phase in phases), 0.0])
        self._amplitude_deg = np.array([*(phase.amplitude for phase in phases), 0.0])
        self._wanted_gain = np.array(
            [*(np.nan if phase.wanted_gain is None else phase.wanted_gain for phase in phases), np.nan]
        )
        self.reset([])

    def reset(self, seeds: Sequence[int], which: NDArray[np.bool_] | None = None) -> None:
        """Begin the protocol, the eye at rest."""
        if which is None:
            batch = len(seeds)
            which = np.ones(batch, dtype=np.bool_)
            self.elapsed_ns: NDArray[np.int64] = np.zeros(batch, dtype=np.int64)
            self.eye_deg_s, self._command_deg_s, self._noise_deg_s = np.zeros((3, batch))
            self._generators = [np.random.default_rng(seed) for seed in seeds]
        else:
            for i, seed in zip(np.flatnonzero(which), seeds, strict=True):
                self._generators[i] = np.random.default_rng(seed)
        self.elapsed_ns[which] = 0
        for values in (self.eye_deg_s, self._command_deg_s, self._noise_deg_s):
            values[which] = 0.0

    @property
    def phase(self) -> NDArray[np.int64]:
        """The number of the phase in which each subject is; one more than there are behind the last."""
        return np.searchsorted(self._ends_ns, self.elapsed_ns, side="right")

    @property
    def cycles(self) -> Array:
        """How many cycles of its phase are behind each subject."""
        phase = self.phase
        return np.asarray((self.elapsed_ns - self._begins_ns[phase]) * 1e-9 * self._frequency_Hz[phase])

    @property
    def head_deg_s(self) -> Array:
        """The velocity of each head, to the left."""
        phase = self.phase
        fastest = 2 * math.pi * self._frequency_Hz[phase] * self._amplitude_deg[phase]
        return np.asarray(fastest * np.sin(2 * math.pi * self.cycles))

    @property
    def slip_deg_s(self) -> Array:
        """The velocity of each image over the retina, to the right; not a number in the dark."""
        return np.asarray(self._wanted_gain[self.phase] * self.head_deg_s - self.eye_deg_s)

    def read(self) -> dict[str, Array]:
        """Return the velocities of head, eye and image."""
        slip_deg_s = np.nan_to_num(self.slip_deg_s + self._noise_deg_s)
        return {
            "head": self.head_deg_s[:, None],
            "eye": self.eye_deg_s[:, None].copy(),
            "slip": np.stack([-slip_deg_s, slip_deg_s], axis=1),
        }

    def advance(self, commands: Mapping[str, Array], duration_ns: int) -> None:
        """Turn on; the eye comes nearer to its command, with its time constant."""
        if "eye" in commands:
            self._command_deg_s = np.array(commands["eye"][:, 0], dtype=np.float64)
        share = -math.expm1(-duration_ns / self.config.time_constant)
        self.eye_deg_s = self.eye_deg_s + share * (self._command_deg_s - self.eye_deg_s)
        self.elapsed_ns = self.elapsed_ns + duration_ns
        if self.config.slip_noise:
            drawn = [generator.standard_normal() for generator in self._generators]
            self._noise_deg_s = self.config.slip_noise * np.array(drawn)

    def stop(self) -> None:
        """Command the eye to stand still."""
        self._command_deg_s = np.zeros_like(self._command_deg_s)
