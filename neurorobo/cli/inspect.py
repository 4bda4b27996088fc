"""Commands that look at files and plugins without running anything: validate, plan, graph, plugins, schema."""

import json
from pathlib import Path

import click

from neurorobo.cli.options import file_argument, json_option, overrides_option


@click.command()
@click.argument("files", nargs=-1, required=True, type=click.Path(path_type=Path, dir_okay=False))
@overrides_option
def validate(files: tuple[Path, ...], overrides: tuple[str, ...]) -> None:
    """Check experiment files and report every fault with its line.

    The weights that they name are checked too.
    """
    from neurorobo.config.experiment import load_experiment
    from neurorobo.errors import NeuroroboError
    from neurorobo.experiment.lessons import read_lessons
    from neurorobo.experiment.plan import build_plan
    from neurorobo.experiment.weights import check_weights
    from neurorobo.plugins import Registry

    registry = Registry.discover()
    faults: list[str] = []
    for file in files:
        before = len(faults)
        try:
            experiment = load_experiment(file, overrides, registry)
            plan = build_plan(experiment)
            try:
                check_weights(experiment, plan)
            except NeuroroboError as error:
                faults.append(str(error))
            read_lessons(experiment, registry)
        except NeuroroboError as error:
            faults.append(str(error))
        if len(faults) == before:
            click.echo(f"{file}: ok")
    if faults:
        raise NeuroroboError("\n".join(faults))


@click.command()
@file_argument
@overrides_option
def plan(file: Path, overrides: tuple[str, ...]) -> None:
    """Print the schedule: what runs when, and in which order.

    Below each step stands where its inputs come from, and every conversion.
    """
    from neurorobo.config.experiment import load_experiment
    from neurorobo.experiment.plan import build_plan
    from neurorobo.plugins import Registry
    from neurorobo.views.schedule import schedule_lines

    for line in schedule_lines(build_plan(load_experiment(file, overrides, Registry.discover()))):
        click.echo(line)


@click.command()
@file_argument
@overrides_option
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="Write here instead of printing.")
def graph(file: Path, overrides: tuple[str, ...], out: Path | None) -> None:
    """Draw the region graph as a Mermaid flowchart.

    Markdown viewers show it as a picture.
    """
    from neurorobo.config.experiment import load_experiment
    from neurorobo.experiment.plan import build_plan
    from neurorobo.files import write_whole
    from neurorobo.plugins import Registry
    from neurorobo.views.mermaid import mermaid_lines

    text = "\n".join(mermaid_lines(build_plan(load_experiment(file, overrides, Registry.discover())))) + "\n"
    if out is None:
        click.echo(text, nl=False)
    else:
        write_whole(out, text.encode())


@click.command()
@json_option
@click.pass_context
def plugins(context: click.Context, as_json: bool) -> None:
    """List the installed plugins and what each provides."""
    from neurorobo.plugins import Registry

    registry = Registry.discover()
    found = registry.plugins()
    if as_json:
        click.echo(
            json.dumps(
                [
                    {
                        "name": plugin.name,
                        "distribution": plugin.distribution,
                        "version": plugin.version,
                        "status": plugin.status,
                        "error": plugin.error,
                        "provides": [{"kind": e.kind, "name": e.name, "summary": e.summary} for e in plugin.provides],
                    }
                    for plugin in found
                ],
                indent=2,
            )
        )
        return
    from neurorobo.cli.plugin_commands import plugin_commands, typed_name

    main = context.find_root().command
    taken = main.commands if isinstance(main, click.Group) else ()
    callable_commands = plugin_commands(registry, taken)
    for plugin in found:
        click.echo(f"{plugin.name}  ({plugin.distribution} {plugin.version}, {plugin.status})")
        if plugin.error:
            click.echo(f"  {plugin.error}")
        for entry in sorted(plugin.provides, key=lambda entry: (entry.kind, entry.name)):
            click.echo(f"  {entry.kind:9} {entry.name:36} {entry.summary}")
            if entry.kind == "command" and (other := callable_commands.get(typed_name(entry))) != entry:
                owner = f"`{other.name}`" if other else "a command of neurorobo's own"
                click.echo(f"  {'':9} cannot be called: `{typed_name(entry)}` is {owner}")


@click.command()
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="Write here instead of printing.")
@click.option("--check", type=click.Path(path_type=Path, dir_okay=False), help="Only check that this file is current.")
def schema(out: Path | None, check: Path | None) -> None:
    """Print the JSON Schema of experiment files, for editors.

    It holds the types of every installed plugin.
    """
    from neurorobo.config.schema import experiment_schema
    from neurorobo.errors import NeuroroboError
    from neurorobo.files import write_whole
    from neurorobo.plugins import Registry

    text = json.dumps(experiment_schema(Registry.discover()), indent=2, ensure_ascii=False) + "\n"
    if check is not None:
        if not check.exists() or check.read_text(encoding="utf-8") != text:
            raise NeuroroboError(f"{check} is not current; run `neurorobo schema --out {check}`")
        click.echo(f"{check}: current")
    elif out is not None:
        write_whole(out, text.encode())
    else:
        click.echo(text, nl=False)
