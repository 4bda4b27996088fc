"""The command line. Commands import what they need when they run, so that ``--help`` is quick."""

import sys
from typing import TYPE_CHECKING

import click

import neurorobo
from neurorobo.cli.compare import compare
from neurorobo.cli.doctor import doctor
from neurorobo.cli.exchange import export_command, import_command
from neurorobo.cli.exit_codes import BAD_INPUT, INTERRUPTED
from neurorobo.cli.inspect import graph, plan, plugins, schema, validate
from neurorobo.cli.measure import measure
from neurorobo.cli.new import new
from neurorobo.cli.run import run
from neurorobo.cli.train import train
from neurorobo.cli.view import view
from neurorobo.errors import NeuroroboError

if TYPE_CHECKING:
    from neurorobo.plugins import Entry


class _Commands(click.Group):
    """The core's commands and those that plugins register, which are imported only when they are called."""

    def list_commands(self, context: click.Context) -> list[str]:
        """Return every command's name, the plugins' after the core's."""
        return [*self.commands, *self._of_plugins()]

    def get_command(self, context: click.Context, name: str) -> click.Command | None:
        """Return a command; for a plugin's, one that says no more than its summary."""
        if (own := super().get_command(context, name)) is not None:
            return own
        entry = self._of_plugins().get(name)
        if entry is None:
            return None
        summary = f"{entry.summary[:1].upper()}{entry.summary[1:]}."
        return click.Command(name, help=summary, short_help=summary)

    def resolve_command(
        self, context: click.Context, arguments: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Return the command that is called, imported."""
        name, command, rest = super().resolve_command(context, arguments)
        if name is None or name in self.commands or (entry := self._of_plugins().get(name)) is None:
            return name, command, rest
        from neurorobo.plugins import Registry

        command = Registry.discover().get("command", entry.name)
        if not isinstance(command, click.Command):
            raise NeuroroboError(f"`{entry.name}` is broken: `{entry.target}` is no click command; tell its author")
        return name, command, rest

    def _of_plugins(self) -> dict[str, "Entry"]:
        from neurorobo.cli.plugin_commands import plugin_commands
        from neurorobo.plugins import Registry

        return plugin_commands(Registry.discover(), self.commands)


@click.group(cls=_Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(neurorobo.__version__, prog_name="neurorobo")
def cli() -> None:
    """Spiking neural networks that control robots: declare a region graph in YAML, run it, train it.

    Exit codes: 0 all went well; 1 a defect of the program; 2 bad input, or a place that cannot be written; 3 an episode
    of `run` did not succeed; 130 interrupted.
    """


for command in (
    run,
    train,
    compare,
    measure,
    view,
    validate,
    plan,
    graph,
    export_command,
    import_command,
    plugins,
    new,
    schema,
    doctor,
):
    cli.add_command(command)


def main() -> None:
    """Run the command line and exit with its code; a fault of the user's is one clear message."""
    try:
        sys.exit(cli.main(standalone_mode=False))
    except NeuroroboError as error:
        click.echo(str(error), err=True)
        sys.exit(BAD_INPUT)
    except click.ClickException as error:
        error.show()
        sys.exit(error.exit_code)
    except (click.Abort, KeyboardInterrupt) as error:
        kept = str(error.__cause__ or error)  # click turns an interrupt, which may say what it leaves, into an Abort
        click.echo(f"interrupted; {kept}" if kept else "interrupted", err=True)
        sys.exit(INTERRUPTED)
    except BrokenPipeError:
        sys.stderr.close()
        sys.exit(0)


if __name__ == "__main__":
    main()
