"""The train command: the phases of an experiment, resumable."""

from collections.abc import Mapping
from pathlib import Path
from statistics import fmean
from typing import Any

import click

from neurorobo.cli.options import file_argument, overrides_option


@click.command()
@file_argument
@overrides_option
@click.option("--only", multiple=True, metavar="REGION", help="Train only the phases of this region; repeatable.")
@click.option("--threads", default=2, show_default=True, type=click.IntRange(1), help="Cores to use.")
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    help="Folder for the results. Default: runs/<name>/training-<hash of the file and its overrides>.",
)
def train(file: Path, overrides: tuple[str, ...], only: tuple[str, ...], threads: int, out: Path | None) -> None:
    """Train the regions of FILE by its `train` phases.

    The same command goes on where it was stopped; Ctrl-C loses nothing.
    """
    from neurorobo.config.experiment import load_experiment
    from neurorobo.errors import NeuroroboError
    from neurorobo.experiment.lessons import read_lessons
    from neurorobo.experiment.plan import build_plan
    from neurorobo.experiment.weights import check_weights
    from neurorobo.plugins import Registry

    registry = Registry.discover()
    experiment = load_experiment(file, overrides, registry)
    plan = build_plan(experiment)  # a file is trained whole, or refused as `validate` refuses it, but for most weights
    lessons = read_lessons(experiment, registry)
    if not lessons:
        raise NeuroroboError(f"{file} has no `train` phases; add some, as the guide to training shows")
    taught: set[str] = set()
    for lesson in lessons:
        pupils = lesson.phase.pupils.keys()
        if not only or not pupils.isdisjoint(only):
            begins = pupils - taught if lesson.phase.from_weights else set()
            taught |= pupils
            if lesson.phase.needs_rollout:
                check_weights(experiment, plan, but=taught - begins)  # of those that it acts together with
    import torch

    from neurorobo.experiment.train import train_experiment
    from neurorobo.views.progress import training_progress

    torch.set_num_threads(threads)
    folder = out or Path("runs") / experiment.name / f"training-{experiment.config_hash[:8]}"
    try:
        with training_progress() as show:
            reports = train_experiment(
                experiment,
                lessons,
                folder,
                only=only,
                report=lambda index, step: show(
                    f"{index} {' '.join(lessons[index].phase.pupils)}", step.done, step.steps, step.error, step.rate
                ),
            )
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"the same command goes on from what is in {folder}" if folder.exists() else "nothing was trained yet"
        ) from None
    for finished in reports:
        click.echo(f"phase {finished.index} {' '.join(finished.regions)}: {_figures(finished.evaluation) or 'done'}")
    click.echo(f"weights  {folder}")


def _figures(evaluation: Mapping[str, Any]) -> str:
    """Return the figures that the core's rules give; a plugin's rule may have others, and this nothing."""
    if rms := evaluation.get("rms"):
        errors = (f"{port} {[round(value, 3) for value in windows[-1]]}" for port, windows in rms.items())
        return f"rms error {', '.join(errors)}"
    if held_out := evaluation.get("held_out"):
        before, after = (fmean(held_out[when]["return"]) for when in ("before", "after"))
        return f"return {before:.4g} before, {after:.4g} after"
    return ""
