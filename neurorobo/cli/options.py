"""Options that several commands share."""

import shlex
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from neurorobo.seeds import LARGEST_SEED

Command = Callable[..., Any]

file_argument = click.argument("file", type=click.Path(path_type=Path, dir_okay=False))

overrides_option = click.option(
    "--set",
    "overrides",
    multiple=True,
    metavar="PATH=VALUE",
    help="Replace a value of the file, e.g. --set body.gap='40 um'; repeatable.",
)
json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON instead of a table.")
seed_option = click.option(
    "--seed",
    type=click.IntRange(0, LARGEST_SEED),
    help="Seed of the first episode; the next ones follow on. Default: the file's, which also draws untrained weights.",
)
episodes_option = click.option(
    "--episodes",
    default=1,
    show_default=True,
    type=click.IntRange(1),
    help="How many episodes, with consecutive seeds.",
)
out_option = click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    help="Folder for the results. Default: runs/<name>/<time>-<hash>.",
)


def typed() -> str:
    """Return what was typed, quoted so that a shell takes it back."""
    return shlex.join(["neurorobo", *sys.argv[1:]])
