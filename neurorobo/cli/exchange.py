"""The export and import commands: networks for other libraries, and from them."""

from pathlib import Path

import click

from neurorobo.cli.options import file_argument, overrides_option


@click.command("export")
@file_argument
@overrides_option
@click.option("--region", metavar="NAME", help="The region to export. Default: every one that can be, into a folder.")
@click.option(
    "--nir", "out", required=True, type=click.Path(path_type=Path), help="The NIR file to write, or the folder."
)
def export_command(file: Path, overrides: tuple[str, ...], region: str | None, out: Path) -> None:
    """Write spiking regions of FILE, with their weights, as NIR.

    snnTorch, SpikingJelly, Norse and others read it. What NIR cannot say is refused by name.
    """
    from neurorobo.config.experiment import load_experiment
    from neurorobo.errors import NeuroroboError, did_you_mean
    from neurorobo.experiment.plan import build_plan
    from neurorobo.experiment.weights import check_weights
    from neurorobo.interchange.library import nir
    from neurorobo.plugins import Registry

    nir()
    if region is not None and out.is_dir():
        raise NeuroroboError(f"{out} is a folder; name a file with `--nir`, such as {out / f'{region}.nir'}")
    registry = Registry.discover()
    experiment = load_experiment(file, overrides, registry)
    plan = build_plan(experiment)
    used = list(dict.fromkeys(use.region for use in plan.uses()))
    if region is not None and region not in used:
        raise NeuroroboError(f"no step of {file} uses a region `{region}`{did_you_mean(region, used)}")
    check_weights(experiment, plan)
    from neurorobo.experiment.build import build_brain
    from neurorobo.interchange.export import to_graph, write_graph

    brain = build_brain(experiment, plan)
    graphs, refused = {}, []
    for name in used if region is None else [region]:
        try:
            graphs[name] = to_graph(brain.region(name), registry)
        except NeuroroboError as error:
            refused.append(f"`{name}` cannot be exported: {error}")
    if not graphs:
        raise NeuroroboError("\n".join(refused))
    for name, (graph, unsaid) in graphs.items():
        path = out / f"{name}.nir" if region is None else out
        try:
            write_graph(graph, path)
        except NeuroroboError as error:
            raise NeuroroboError(str(error).replace("`--out`", "`--nir`")) from error
        click.echo(f"{name}: {path}")
        if experiment.regions[name].weights is None:
            click.echo("  with fresh weights, untrained")
        for part in unsaid:
            click.echo(f"  without {part}")
    for line in refused:
        click.echo(line)


@click.command("import")
@file_argument
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="The YAML file to write.")
@click.option("--dt", metavar="TIME", help="The time step of the network. Default: what the file notes, or 0.1 ms.")
def import_command(file: Path, out: Path | None, dt: str | None) -> None:
    """Turn a NIR file into a region and an experiment that runs it.

    Without --out the experiment is printed and nothing is written; with it, the weights are written beside it.
    """
    from neurorobo.errors import NeuroroboError
    from neurorobo.interchange.library import nir
    from neurorobo.plugins import Registry
    from neurorobo.units import UnitError, parse_quantity

    nir()
    try:
        step_s = None if dt is None else parse_quantity(dt, "s")
    except UnitError as error:
        raise NeuroroboError(f"--dt {dt}: {error}") from None
    if step_s is not None and step_s <= 0:
        raise NeuroroboError(f"--dt {dt}: a time step is longer than zero, e.g. '0.1 ms'")
    from neurorobo.interchange.importing import import_network

    imported = import_network(file, Registry.discover(), step_s)
    if out is None:
        click.echo(imported.text, nl=False)
        return
    weights = imported.write(out)
    click.echo(f"region   {imported.name}, in {out}")
    click.echo(f"weights  {weights}")
    for difference in imported.differences:
        click.echo(f"note     {difference}")
