"""The doctor command: what this installation runs on."""

import json
import platform
from importlib.metadata import version

import click

import neurorobo
from neurorobo.cli.options import json_option

PACKAGES = ("torch", "numpy")


@click.command()
@json_option
def doctor(as_json: bool) -> None:
    """Tell what this installation runs on.

    Versions, the path that the engine takes and why, its instruction set, and threads.
    """
    import torch

    from neurorobo.engine import engine_path

    path = engine_path()
    report = {
        "python": platform.python_version(),
        "neurorobo": neurorobo.__version__,
        **{package: version(package) for package in PACKAGES},
        "system": f"{platform.system()} {platform.machine()}",
        "engine": path.name,
        "reason": path.reason,
        "instructions": path.instructions,
        "torch_instructions": torch.backends.cpu.get_cpu_capability(),
        "threads": torch.get_num_threads(),
    }
    if as_json:
        click.echo(json.dumps(report, indent=2))
        return
    for name, value in report.items():
        click.echo(f"{name.replace('_', ' '):19} {'none' if value is None else value}")
