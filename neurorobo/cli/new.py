"""The new command: a plugin to begin with."""

from pathlib import Path

import click


@click.command()
@click.argument("kind")
@click.argument("name")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="Folder to make for the package. Default: one with the plugin's name, here.",
)
@click.pass_context
def new(context: click.Context, kind: str, name: str, out: Path | None) -> None:
    """Make a plugin to begin with.

    KIND is one of region, neuron, code, rule, body and command. NAME is what files will call it, such as my_lab.reflex:
    the plugin and its package are then called my_lab. A name without a dot stands for both.

    The package has tests, which pass, and an experiment that uses it.
    """
    from neurorobo.cli.scaffold import next_commands, read_names, sort_of, write_plugin
    from neurorobo.errors import NeuroroboError
    from neurorobo.plugins import Registry

    sort_of(kind)
    names = read_names(kind, name, Registry.discover())
    commands = context.find_root().command
    if kind == "command" and isinstance(commands, click.Group) and names.typed in commands.list_commands(context):
        raise NeuroroboError(f"`neurorobo {names.typed}` is a command that there is; choose another name")
    folder = out or Path(names.prefix)
    write_plugin(kind, names, folder)
    click.echo(f"{folder}: the {kind} {names.prefix}.{names.name}; next:\n")
    for line in next_commands(kind, names, folder):
        click.echo(f"  {line}")
