"""The compare command: several experiments or runs side by side."""

import json
from pathlib import Path

import click

from neurorobo.cli.options import json_option, out_option, overrides_option, seed_option, typed


@click.command()
@click.argument("files", nargs=-1, required=True, type=click.Path(path_type=Path))
@overrides_option
@click.option(
    "--variant",
    "variants",
    multiple=True,
    metavar="PATH=VALUE",
    help="Add the first file once more with this value replaced, such as regions.cortex=acme.teacher; repeatable.",
)
@seed_option
@click.option(
    "--episodes",
    default=10,
    show_default=True,
    type=click.IntRange(1),
    help="Episodes of each experiment, with the same seeds.",
)
@out_option
@json_option
def compare(
    files: tuple[Path, ...],
    overrides: tuple[str, ...],
    variants: tuple[str, ...],
    seed: int | None,
    episodes: int,
    out: Path | None,
    as_json: bool,
) -> None:
    """Put the figures of experiments or runs side by side.

    FILES are experiments, which are run over the same seeds, or folders of runs. Each experiment gets a run folder of
    its own; if you stop, give the folders of those that are finished in place of their files.
    """
    from neurorobo.config.experiment import load_experiment
    from neurorobo.errors import NeuroroboError
    from neurorobo.experiment.plan import build_plan
    from neurorobo.experiment.run_folder import RunFolder
    from neurorobo.experiment.weights import check_weights
    from neurorobo.plugins import Registry

    registry = Registry.discover()
    names = [str(file) if file.is_dir() else file.stem for file in files] + list(variants)
    if twice := {name for name in names if names.count(name) > 1}:
        raise NeuroroboError(f"two experiments would be called `{twice.pop()}`; give files of different names")
    experiments = {file.stem: load_experiment(file, overrides, registry) for file in files if not file.is_dir()}
    experiments |= {change: load_experiment(files[0], (*overrides, change), registry) for change in variants}
    for experiment in experiments.values():
        check_weights(experiment, build_plan(experiment))  # all that can be told before the slow imports
    summaries = {str(file): RunFolder(file).summary() for file in files if file.is_dir()}
    import torch

    from neurorobo.experiment.run import run_experiment
    from neurorobo.views.progress import RunProgress

    torch.set_num_threads(1)  # as for a run
    for name, experiment in experiments.items():
        first = experiment.seed if seed is None else seed
        folder = None if out is None else out / name.replace("/", "_")
        seeds = range(first, first + episodes)
        with RunProgress() as progress:
            finished = run_experiment(
                experiment, registry, seeds, folder, record=(), command=typed(), progress=progress
            )
        summaries[name] = finished.summary
        click.echo(f"{name}: {finished.folder.path}", err=True)
    summaries = {name: summaries[name] for name in names}
    if as_json:
        click.echo(json.dumps(summaries, indent=2))
    else:
        from rich.console import Console

        from neurorobo.views.tables import comparison_table

        Console().print(comparison_table(summaries))
