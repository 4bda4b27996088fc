"""The measure command: what the regions of a brain cost while it works."""

import json
from pathlib import Path

import click

from neurorobo.cli.options import episodes_option, file_argument, json_option, overrides_option, seed_option


@click.command()
@file_argument
@overrides_option
@seed_option
@episodes_option
@json_option
def measure(file: Path, overrides: tuple[str, ...], seed: int | None, episodes: int, as_json: bool) -> None:
    """Run the experiment FILE and count what each region costs.

    Parameters, footprint and sparsity, and the synaptic operations of a control period, by NeuroBench's definitions.
    """
    from neurorobo.config.experiment import load_experiment
    from neurorobo.experiment.plan import build_plan
    from neurorobo.experiment.weights import check_weights
    from neurorobo.plugins import Registry

    experiment = load_experiment(file, overrides, Registry.discover())
    check_weights(experiment, build_plan(experiment))
    import torch

    from neurorobo.experiment.measure import measure_experiment
    from neurorobo.views.progress import RunProgress

    torch.set_num_threads(1)
    first = experiment.seed if seed is None else seed
    with RunProgress() as progress:
        found = measure_experiment(experiment, range(first, first + episodes), progress)
    if as_json:
        click.echo(json.dumps(found, indent=2))
        return
    from rich.console import Console

    from neurorobo.views.tables import size_table, work_table

    console = Console()
    console.print(size_table(experiment.name, found))
    console.print(work_table(found))
    for name, region in found["regions"].items():
        if region["not_counted"]:
            click.echo(f"not counted in {name}: {', '.join(region['not_counted'])}")
