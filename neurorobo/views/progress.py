"""Progress of long work on the error stream: bars on a terminal, a line now and then elsewhere."""

import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn

LINES_PER_PHASE = 20
"""How often a phase of training is reported where there is no terminal."""


def on_a_terminal() -> bool:
    """Return whether the error stream is a terminal."""
    return sys.stderr.isatty()


class RunProgress:
    """Shows the tick of a run and how many episodes are still running; there is no telling when an episode ends."""

    def __init__(self) -> None:
        """Prepare the line; it is shown from ``with`` on."""
        columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
        self._bars = Progress(*columns, console=Console(stderr=True), disable=not on_a_terminal(), transient=True)
        self._task = self._bars.add_task("building")

    def __enter__(self) -> Self:
        """Start showing."""
        self._bars.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Take the line away."""
        self._bars.stop()

    def __call__(self, tick: int, running: int) -> None:
        """Show a tick."""
        self._bars.update(self._task, description=f"tick {tick}, {running} running")


class TrainingProgress:
    """Shows, for each phase of training, the steps done, the errors and the firing rate."""

    def __init__(self, bars: Progress) -> None:
        """Report to ``bars``; see :func:`training_progress`."""
        self._bars = bars
        self._tasks: dict[str, TaskID] = {}

    def __call__(self, phase: str, done: int, steps: int, error: Mapping[str, float], rate: float) -> None:
        """Show that ``done`` of ``steps`` steps of a phase are done."""
        figures = "  ".join(f"{name} {value:.3g}" for name, value in error.items()) + f"  rate {rate:.2f}"
        if self._bars.disable:
            if done % max(1, steps // LINES_PER_PHASE) == 0 or done == steps:
                print(f"{phase}: {done} of {steps}  {figures}", file=sys.stderr, flush=True)
            return
        if phase not in self._tasks:
            self._tasks[phase] = self._bars.add_task(phase, total=steps, figures="")
        self._bars.update(self._tasks[phase], completed=done, figures=figures)


@contextmanager
def training_progress() -> Iterator[TrainingProgress]:
    """Show the progress of training while the block runs."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.fields[figures]}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), disable=not on_a_terminal()) as bars:
        yield TrainingProgress(bars)
