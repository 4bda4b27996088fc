"""The train command: the phases of an experiment, resumable."""

from pathlib import Path

import click

from neurorobo.cli.options import file_argument, out_option, overrides_option, quiet


@click.command()
@file_argument
@overrides_option
@click.option("--only", multiple=True, metavar="REGION", help="Train only the phases of this region; repeatable.")
@click.option("--threads", default=2, show_default=True, type=click.IntRange(1), help="Cores to use.")
@out_option
def train(file: Path, overrides: tuple[str, ...], only: tuple[str, ...], threads: int, out: Path | None) -> None:
    """Train the regions of FILE by its `train` phases.

    The same command goes on where it was stopped; Ctrl-C loses nothing.
    """
    import torch
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    from neurorobo.config.experiment import load_experiment
    from neurorobo.errors import NeuroroboError
    from neurorobo.experiment.lessons import read_lessons
    from neurorobo.experiment.train import train_experiment
    from neurorobo.learning.supervise import Progress as Step
    from neurorobo.plugins import Registry

    registry = Registry.discover()
    experiment = load_experiment(file, overrides, registry)
    lessons = read_lessons(experiment, registry)
    if not lessons:
        raise NeuroroboError(f"{file} has no `train` phases; add some, or look at examples/peg_in_hole.yaml")
    torch.set_num_threads(threads)
    folder = out or Path("runs") / experiment.name / f"training-{experiment.config_hash[:8]}"
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.fields[figures]}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), disable=quiet()) as bars:
        shown: dict[int, int] = {}

        def report(index: int, step: Step) -> None:
            phase = lessons[index].phase
            if index not in shown:
                shown[index] = int(bars.add_task(f"{index} {phase.region}", total=step.steps, figures=""))
            errors = "  ".join(f"{name} {error:.3g}" for name, error in step.error.items())
            bars.update(
                bars.task_ids[list(shown).index(index)], completed=step.done, figures=f"{errors}  rate {step.rate:.2f}"
            )

        reports = train_experiment(experiment, lessons, folder, only=only, report=report)
    for finished in reports:
        errors = ", ".join(
            f"{port} {[round(v, 3) for v in rms[-1]]}" for port, rms in finished.evaluation["rms"].items()
        )
        click.echo(f"phase {finished.index} {finished.region}: rms error {errors}")
    click.echo(f"weights  {folder}")
