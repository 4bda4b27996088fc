"""The command ``neurorobo identify``."""

from pathlib import Path
from typing import TYPE_CHECKING

import click
from click.core import ParameterSource

from neurorobo.errors import NeuroroboError

if TYPE_CHECKING:
    from precision_interaction.identification.analysis import Analysis
    from precision_interaction.identification.log import ContactLog
    from precision_interaction.rig.insertion_body_config import InsertionBodyConfig

OF_SIMULATION = ("repetitions", "depth", "filtered", "seed")


@click.command()
@click.argument("log", type=click.Path(path_type=Path, dir_okay=False))
@click.option(
    "--out",
    required=True,
    type=click.Path(path_type=Path, dir_okay=False),
    help="File for the fitted contact: what stands under `body: contact:` of an experiment.",
)
@click.option(
    "--law",
    default="auto",
    show_default=True,
    type=click.Choice(["auto", "measured", "proportional"]),
    help="Lines with an intercept, or through the origin; `auto` takes the latter unless an intercept is beyond doubt.",
)
@click.option(
    "--simulate",
    metavar="EXPERIMENT",
    type=click.Path(path_type=Path, dir_okay=False),
    help="First make LOG on the simulated body of this experiment.",
)
@click.option(
    "--repetitions", default=400, show_default=True, type=click.IntRange(10), help="Insertions of each simulated step."
)
@click.option(
    "--depth",
    default=0.0,
    show_default=True,
    type=click.FloatRange(0),
    help="How deep in the hole each simulated step begins, in um.",
)
@click.option("--filtered", is_flag=True, help="Read the simulated force as if its sensor were filtered.")
@click.option("--seed", default=0, show_default=True, type=click.IntRange(0), help="Seed of the simulated body.")
@click.pass_context
def identify(
    context: click.Context,
    log: Path,
    out: Path,
    law: str,
    simulate: Path | None,
    repetitions: int,
    depth: float,
    filtered: bool,
    seed: int,
) -> None:
    """Fit the contact of a rig to LOG, a CSV or Parquet file with a row for each of many insertions.

    Its columns are step_um, the commanded axial step, and increment_x_mN, increment_y_mN and, if measured,
    increment_z_mN: the radial (and axial) force after the step minus that before. Repeat each of several steps at least
    ten times, better hundreds of times, withdrawing in between.
    """
    from neurorobo.files import write_whole
    from precision_interaction.identification.analysis import analyse
    from precision_interaction.identification.doubts import doubts
    from precision_interaction.identification.fragment import as_yaml, contact_of
    from precision_interaction.identification.log import read_log, write_log

    if out.exists():
        raise NeuroroboError(
            f"{out} exists already, and is left as it is; remove it, or choose another place with `--out`"
        )
    if simulate is None:
        given = [name for name in OF_SIMULATION if context.get_parameter_source(name) is ParameterSource.COMMANDLINE]
        if given:
            raise NeuroroboError(
                f"--{given[0]} is about a simulated log, and {log} is read as it is; leave it out, or add "
                "`--simulate EXPERIMENT`"
            )
    else:
        if log.exists():
            raise NeuroroboError(f"{log} is there already; remove it, or name another place for the simulated log")
        from precision_interaction.identification.experiment import STEPS_UM, insert_and_withdraw

        body = _body_of(simulate)
        if depth + max(STEPS_UM) > body.length:
            raise NeuroroboError(
                f"--depth {depth:g}: from there, a step of {max(STEPS_UM):g} um does not fit the {body.length:g} um of "
                f"{simulate}; take {body.length - max(STEPS_UM):g} or less"
            )
        if filtered:
            body = body.model_copy(update={"force_resolution": 0.0})
        write_log(insert_and_withdraw(body, repetitions=repetitions, seed=seed, depth_um=depth), log)
    found = read_log(log)
    analysis = analyse(found)
    if law == "auto":
        fit = analysis.best()
    elif law == "proportional":
        fit = analysis.proportional
    elif analysis.measured is None:
        raise NeuroroboError(f"{log}: one step tells no intercept; log several steps, or take `--law proportional`")
    else:
        fit = analysis.measured
    comment = f"{_steps(found)} of {log.name}; put this under `body: contact:` of an experiment"
    write_whole(out, as_yaml(contact_of(analysis, fit), comment).encode())
    _print(analysis)
    for doubt in doubts(found, analysis, fit):
        click.echo(f"note: {doubt}", err=True)
    click.echo(f"law       {fit.law}")
    click.echo(f"contact   {out}")


def _body_of(experiment: Path) -> "InsertionBodyConfig":
    from neurorobo.config.experiment import load_experiment
    from precision_interaction.rig.insertion_body_config import InsertionBodyConfig

    body = load_experiment(experiment).body
    if not isinstance(body, InsertionBodyConfig):
        raise NeuroroboError(f"{experiment}: its body cannot insert by itself; log insertions on it instead")
    return body


def _steps(log: "ContactLog") -> str:
    steps = log.steps_um
    if len(steps) == 1:
        return f"{len(log.step_um)} insertions of {steps[0]:g} um"
    return f"{len(log.step_um)} insertions at {len(steps)} steps of {steps[0]:g} to {steps[-1]:g} um"


def _print(analysis: "Analysis") -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table("step, um", "insertions", "mean x, y, mN", "variance x, y, mN^2", "R^2 x, y")
    for i, step in enumerate(analysis.step_um):
        figures = (analysis.mean_mN[i, :2], analysis.variance_mN2[i, :2], analysis.radial_r_squared[i])
        cells = [
            ", ".join(f"{value:.{digits}f}" for value in row) for row, digits in zip(figures, (2, 2, 3), strict=True)
        ]
        table.add_row(f"{step:g}", f"{analysis.repetitions[i]:.0f}", *cells)
    Console().print(table)
