"""The command line. Commands import what they need when they run, so that ``--help`` is quick."""

import sys

import click

import neurorobo
from neurorobo.cli.compare import compare
from neurorobo.cli.exit_codes import BAD_INPUT, INTERRUPTED
from neurorobo.cli.inspect import graph, plan, plugins, schema, validate
from neurorobo.cli.run import run
from neurorobo.cli.train import train
from neurorobo.cli.view import view
from neurorobo.errors import NeuroroboError


class _Commands(click.Group):
    """The core's commands and those that plugins register."""

    def list_commands(self, context: click.Context) -> list[str]:
        """Return every command's name, the plugins' after the core's."""
        return [*self.commands, *_plugin_commands()]

    def get_command(self, context: click.Context, name: str) -> click.Command | None:
        """Return a command; a plugin's is imported only when it is called."""
        own = super().get_command(context, name)
        full_name = _plugin_commands().get(name)
        if own is not None or full_name is None:
            return own
        from neurorobo.plugins import Registry

        command: click.Command = Registry.discover().get("command", full_name)
        return command


def _plugin_commands() -> dict[str, str]:
    """Return the plugins' commands: what is typed, and the full name; a name of the core's cannot be taken."""
    from neurorobo.plugins import Registry

    return {
        entry.name.partition(".")[2].replace("_", "-"): entry.name for entry in Registry.discover().entries("command")
    }


@click.group(cls=_Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(neurorobo.__version__, prog_name="neurorobo")
def cli() -> None:
    """Spiking neural networks that control robots: declare a region graph in YAML, run it, train it.

    Exit codes: 0 all went well; 1 a defect of the program; 2 bad input; 3 an episode did not succeed; 130 interrupted.
    """


for command in (run, train, compare, view, validate, plan, graph, plugins, schema):
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
    except (click.Abort, KeyboardInterrupt):
        click.echo("interrupted", err=True)
        sys.exit(INTERRUPTED)
    except BrokenPipeError:
        sys.stderr.close()
        sys.exit(0)


if __name__ == "__main__":
    main()
