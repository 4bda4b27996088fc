"""The compare command: several experiments or runs side by side."""

import json
from pathlib import Path

import click

from neurorobo.cli.options import json_option, out_option, overrides_option, quiet, seed_option


@click.command()
@click.argument("files", nargs=-1, required=True, type=click.Path(path_type=Path))
@overrides_option
@seed_option
@click.option("--episodes", default=10, show_default=True, type=click.IntRange(1), help="Episodes of each experiment, with the same seeds.")
@out_option
@json_option
def compare(
    files: tuple[Path, ...], overrides: tuple[str, ...], seed: int | None, episodes: int, out: Path | None, as_json: bool
) -> None:
    """Run experiment FILES over the same seeds, or read run folders, and put their figures side by side.

    Each experiment gets a run folder of its own; if you stop, give the folders of those that are finished in place of their files.
    """
    from neurorobo.config.experiment import load_experiment
    from neurorobo.errors import NeuroroboError
    from neurorobo.experiment.run import run_experiment
    from neurorobo.experiment.run_folder import RunFolder
    from neurorobo.plugins import Registry

    registry = Registry.discover()
    experiments = {file: load_experiment(file, overrides, registry) for file in files if not file.is_dir()}
    summaries = {}
    for file in files:
        if file.is_dir():
            name, summary = str(file), RunFolder(file).summary()
        else:
            experiment = experiments[file]
            first = experiment.seed if seed is None else seed
            folder = None if out is None else out / file.stem
            finished = run_experiment(experiment, registry, range(first, first + episodes), folder, record=(), quiet=quiet())
            name, summary = file.stem, finished.summary
            click.echo(f"{name}: {finished.folder.path}", err=True)
        if name in summaries:
            raise NeuroroboError(f"two of the experiments are called `{name}`; give files or folders of different names")
        summaries[name] = summary
    if as_json:
        click.echo(json.dumps(summaries, indent=2))
    else:
        from rich.console import Console

        from neurorobo.views.tables import comparison_table

        Console().print(comparison_table(summaries))
