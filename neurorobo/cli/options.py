"""Options that several commands share."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

Command = Callable[..., Any]

LARGEST_SEED = 2**63 - 1

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
    help="Seed of the first episode; the next ones follow on. Default: the file's.",
)
out_option = click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    help="Folder for the results. Default: runs/<name>/<time>-<hash>.",
)
