"""The task of holding gaze: gain, phase and slip in each phase of the protocol."""

from collections.abc import Sequence
from statistics import fmean

import numpy as np
from numpy.typing import NDArray

from neurorobo.bodies import Array, Body
from neurorobo.errors import NeuroroboError
from neurorobo.tasks.task import Flags, Task
from neurorobo_paradigms.vestibulo_ocular.gaze_task_config import GazeTaskConfig
from neurorobo_paradigms.vestibulo_ocular.response import Cycle, responses
from neurorobo_paradigms.vestibulo_ocular.turntable import Turntable


class GazeTask(Task[Turntable]):
    """Watch head, eye and image until the protocol is over; the reward of a motion is minus the slip (0 in the dark).

    A NeuroroboError if the body is no turntable.
    """

    def __init__(self, config: GazeTaskConfig, body: Body) -> None:
        if not isinstance(body, Turntable):
            raise NeuroroboError(
                f"task: `paradigms.stable_gaze` needs the body `paradigms.turntable`, not a {type(body).__name__}"
            )
        super().__init__(config, body)
        self.config = config
        self.reset(0)

    def reset(self, batch: int, which: Flags | None = None) -> None:
        """Begin `batch` protocols, or begin again those that `which` marks."""
        if which is None:
            which = np.ones(batch, dtype=np.bool_)
            self._seen: list[tuple[NDArray[np.int64], Array]] = []
            self._begin, self._end = np.zeros((2, batch), dtype=np.int64)
        self._begin[which] = self._end[which] = len(self._seen)
        self._before = self._now()

    def observe(self, duration_ns: int, running: Flags) -> None:
        """Take note of a motion: of what was at its beginning."""
        self._seen.append(self._before)
        self._end[running] = len(self._seen)
        self._before = self._now()

    def reward(self) -> Array:
        """Return minus the slip (batch), in deg/s."""
        return -np.nan_to_num(np.abs(self.body.slip_deg_s))

    def terminated(self) -> Flags:
        """Return that no protocol ends by itself."""
        return np.zeros(len(self._end), dtype=np.bool_)

    def truncated(self) -> Flags:
        """Return which protocols are over."""
        return np.asarray(self.body.elapsed_ns >= self.body.config.duration_ns)

    def metrics(self) -> Sequence[dict[str, float]]:
        """Return of each phase gain, lead of the eye and slip at its end, and the slip in its first cycle."""
        found = []
        for i in range(len(self._end)):
            figures: dict[str, float] = {}
            for name, cycles in self.cycles(i).items():
                last = cycles[-self.config.scored_cycles :]
                figures[f"{name}.gain"] = fmean(cycle.gain for cycle in last)
                figures[f"{name}.phase_deg"] = fmean(cycle.phase_deg for cycle in last)
                if self.body.config.phases[name].wanted_gain is not None:
                    figures[f"{name}.first_slip_deg_s"] = cycles[0].slip_deg_s
                    figures[f"{name}.slip_deg_s"] = fmean(cycle.slip_deg_s for cycle in last)
            found.append(figures)
        return found

    def cycles(self, member: int) -> dict[str, list[Cycle]]:
        """Return the whole cycles behind one subject, by phase; phases of which there is none yet are left out."""
        seen = self._seen[self._begin[member] : self._end[member]]
        phase = np.array([phases[member] for phases, _ in seen], dtype=np.int64)
        values = np.array([rows[:, member] for _, rows in seen]).reshape(-1, 4)
        found = {name: responses(*values[phase == number].T) for number, name in enumerate(self.body.names)}
        return {name: cycles for name, cycles in found.items() if cycles}

    def _now(self) -> tuple[NDArray[np.int64], Array]:
        """Return the phase (batch), and cycles behind, head, eye and slip (4, batch)."""
        body = self.body
        return body.phase, np.stack([body.cycles, body.head_deg_s, body.eye_deg_s, body.slip_deg_s])
