"""The run command: episodes of an experiment, recorded in a run folder."""

import json
from pathlib import Path

import click

from neurorobo.cli.exit_codes import EPISODE_FAILED
from neurorobo.cli.options import (
    episodes_option,
    file_argument,
    json_option,
    out_option,
    overrides_option,
    seed_option,
    typed,
)


@click.command()
@file_argument
@overrides_option
@seed_option
@episodes_option
@click.option(
    "--in-a-row",
    is_flag=True,
    help="Run the episodes one after the other; what a region learns in one, it knows in the next.",
)
@click.option("--arm", is_flag=True, help="Let a real body move. A simulated one needs no leave.")
@click.option("--dry-run", is_flag=True, help="Show what a real body would be sent, and move nothing.")
@out_option
@json_option
@click.pass_context
def run(
    context: click.Context,
    file: Path,
    overrides: tuple[str, ...],
    seed: int | None,
    episodes: int,
    in_a_row: bool,
    arm: bool,
    dry_run: bool,
    out: Path | None,
    as_json: bool,
) -> None:
    """Run the experiment FILE and write a run folder."""
    if arm and dry_run:
        raise click.UsageError("--arm lets the body move and --dry-run does not; give one of them")
    from neurorobo.config.experiment import load_experiment
    from neurorobo.experiment.plan import build_plan
    from neurorobo.experiment.weights import check_weights
    from neurorobo.plugins import Registry

    registry = Registry.discover()
    experiment = load_experiment(file, overrides, registry)
    check_weights(experiment, build_plan(experiment))  # all that can be told before the slow imports
    import torch

    from neurorobo.experiment.run import run_experiment
    from neurorobo.views.progress import RunProgress

    # A second thread gains little in a control loop, and a busy neighbour turns it into a loss.
    torch.set_num_threads(1)
    first = experiment.seed if seed is None else seed
    with RunProgress() as progress:
        seeds = range(first, first + episodes)
        finished = run_experiment(
            experiment,
            registry,
            seeds,
            out,
            in_a_row=in_a_row,
            arm=arm,
            dry_run=dry_run,
            command=typed(),
            progress=progress,
        )
    if as_json:
        click.echo(json.dumps({"folder": str(finished.folder.path), **finished.summary}, indent=2))
    else:
        from rich.console import Console

        from neurorobo.views.tables import summary_table

        Console().print(summary_table(experiment.name, finished.summary))
        click.echo(f"run folder  {finished.folder.path}")
        for path in finished.files:
            click.echo(f"{path.stem:11} {path}")
        if any(path.suffix == ".rrd" for path in finished.files):
            click.echo(f"look at it  neurorobo view {finished.folder.path}")
    if any(episode.get("success", 1.0) < 1.0 for episode in finished.summary["episodes"]):
        context.exit(EPISODE_FAILED)
