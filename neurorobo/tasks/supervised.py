"""A task in motion: every command passes through the command layer, and the task sees what came of it."""

from collections.abc import Mapping, Sequence
from typing import Any

from neurorobo.bodies import Array, Supervisor
from neurorobo.tasks.task import Flags, Task


class SupervisedTask:
    """Body, command layer and task as one: what the closed loop and the Gymnasium environments move."""

    def __init__(self, task: Task[Any]) -> None:
        """Join ``task`` and its body; call :meth:`reset` before the first step."""
        self.task = task
        self.body = task.body
        self.supervisor = Supervisor(task.body)

    def reset(self, seeds: Sequence[int], batch: int, which: Flags | None = None) -> None:
        """Begin ``batch`` episodes, one for each seed; with ``which`` (batch), begin again only those, a seed each."""
        self.body.reset(seeds, which)
        self.task.reset(batch, which)
        self.supervisor.reset(batch, which)

    def step(self, commands: Mapping[str, Array], duration_ns: int, running: Flags) -> tuple[dict[str, Array], Flags]:
        """Carry out ``commands`` for ``duration_ns``; return what the body was given, and which episodes have ended.

        Only the ``running`` (batch) episodes count; one that a guard stops has ended. Raises NeuroroboError for a
        command that is not a number.
        """
        given = self.supervisor.advance(commands, duration_ns, running)
        self.task.observe(duration_ns, running)
        return given, self.task.terminated() | self.task.truncated() | self.supervisor.tripped

    def metrics(self) -> list[dict[str, float]]:
        """Return for each episode the task's figures, and ``command_interventions``.

        Where a body has guards, ``safety_stops`` is 1 for an episode that one has stopped, which is no success.
        """
        counts = self.supervisor.interventions.tolist()
        episodes = [
            {**figures, "command_interventions": float(count)}
            for figures, count in zip(self.task.metrics(), counts, strict=True)
        ]
        if self.body.guards():
            for i, figures in enumerate(episodes):
                figures["safety_stops"] = float(i in self.supervisor.trips)
                if i in self.supervisor.trips and "success" in figures:
                    figures["success"] = 0.0
        return episodes
