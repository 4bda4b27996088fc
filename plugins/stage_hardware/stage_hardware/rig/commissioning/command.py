"""The commands ``neurorobo rig check | home | identify | calibrate | reset``."""

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from neurorobo.errors import NeuroroboError

if TYPE_CHECKING:
    from stage_hardware.rig.commissioning.dialogue import Dialogue
    from stage_hardware.rig.commissioning.moves import Touch
    from stage_hardware.rig.commissioning.record import Commissioning

Command = TypeVar("Command", bound=Callable[..., Any])

RIG = click.argument("rig", type=click.Path(path_type=Path, dir_okay=False))
YES = click.option("--yes", is_flag=True, help="Agree to every motion beforehand: only with nobody near.")
AXES = click.option("--axis", "axes", metavar="AXIS", multiple=True, help="Only this axis; any number of times.")
LIMIT = click.option("--limit", metavar="FORCE", help="A larger load stops the rig; by default as in `home`.")
ADDRESSES = "Runs on emulators as well: `neurorobo emulate RIG` writes a rig file with their addresses."


@click.group(help=f"Commission a rig, step by step: check, home, identify, calibrate. {ADDRESSES}")
def rig() -> None:
    """Gather the steps; each writes what the next needs into a file beside the rig's."""


@rig.command()
@RIG
def check(rig: Path) -> None:
    """Connect to each device of RIG, a rig file, and look; nothing moves."""
    from stage_hardware.rig.commissioning.check import check as look

    commissioning, dialogue = _opened(rig, yes=False)
    look(commissioning, dialogue)
    if (refusal := commissioning.latch.refusal()) is not None:
        click.echo(refusal)
    _tell(commissioning, commissioning.command("home" if refusal is None else "reset"))


@rig.command()
@RIG
@click.option("--limit", metavar="FORCE", required=True, help="A larger load than this stops the rig: 0.5N.")
@AXES
@YES
def home(rig: Path, limit: str, axes: Sequence[str], yes: bool) -> None:
    """Let the axes of RIG look for their origins, one after the other, as far as they do not know where they are."""
    from stage_hardware.rig.commissioning.home import home as look_for_origins

    commissioning, dialogue = _opened(rig, yes=yes)
    limit_mN = _quantity("--limit", limit, "mN")
    look_for_origins(commissioning, dialogue, axes, limit_mN)
    _tell(commissioning, commissioning.command("identify"))


def _touching(command: Command) -> Command:
    """Add the options of what looks for contact."""
    for option in (
        click.option("--until", metavar="FORCE", help="The load that counts as contact.  [default: above the noise]"),
        click.option(
            "--within", default="500um", show_default=True, metavar="DISTANCE", help="How far to look for it."
        ),
        click.option("--step", default="5um", show_default=True, metavar="DISTANCE", help="In steps of this length."),
    ):
        command = option(command)
    return command


@rig.command()
@RIG
@AXES
@click.option("--way", default="2mm", show_default=True, metavar="DISTANCE", help="How far axes run freely, at most.")
@click.option("--touch", metavar="AXIS", help="Move this axis into contact, and each axis to and fro there.")
@_touching
@click.option("--amplitude", default="2um", show_default=True, metavar="DISTANCE", help="How far to and fro.")
@click.option("--times", type=click.IntRange(2), default=5, show_default=True, help="How often to and fro.")
@LIMIT
@YES
def identify(
    rig: Path,
    axes: Sequence[str],
    way: str,
    touch: str | None,
    until: str | None,
    within: str,
    step: str,
    amplitude: str,
    times: int,
    limit: str | None,
    yes: bool,
) -> None:
    """Move the axes of RIG: how fast are they, how soon do they stop, which component of the force follows which?"""
    from stage_hardware.rig.commissioning.identify import identify as move

    commissioning, dialogue = _opened(rig, yes=yes)
    limit_mN = _limit_mN(commissioning, limit)
    move(
        commissioning,
        dialogue,
        axes,
        limit_mN,
        way_um=_quantity("--way", way, "um"),
        touch=None if touch is None else _touch(commissioning, touch, until, within, step, limit_mN),
        amplitude_um=_quantity("--amplitude", amplitude, "um"),
        times=times,
    )
    _tell(commissioning, commissioning.command("calibrate", touch or "AXIS"))


@rig.command()
@RIG
@click.option("--touch", metavar="AXIS", required=True, help="The axis that inserts, which is moved into contact.")
@_touching
@click.option("--times", type=click.IntRange(1), default=3, show_default=True, help="How often to touch.")
@click.option(
    "--clearance", default="50um", show_default=True, metavar="DISTANCE", help="How far before contact to begin."
)
@click.option(
    "--out",
    metavar="FILE",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Where to write the calibrated rig.  [default: <rig>.calibrated.yaml]",
)
@LIMIT
@YES
def calibrate(
    rig: Path,
    touch: str,
    until: str | None,
    within: str,
    step: str,
    times: int,
    clearance: str,
    out: Path | None,
    limit: str | None,
    yes: bool,
) -> None:
    """Find where episodes begin on RIG, and write a rig file that begins there, and the body of an experiment."""
    from stage_hardware.rig.commissioning.calibrate import calibrate as find_start

    commissioning, dialogue = _opened(rig, yes=yes)
    limit_mN = _limit_mN(commissioning, limit)
    find_start(
        commissioning,
        dialogue,
        limit_mN,
        _touch(commissioning, touch, until, within, step, limit_mN),
        times=times,
        clearance_um=_quantity("--clearance", clearance, "um"),
        out=out or rig.with_suffix(".calibrated.yaml"),
    )


@rig.command()
@RIG
def reset(rig: Path) -> None:
    """Let RIG move again after a load that has latched it: only when somebody has looked at it."""
    commissioning, dialogue = _opened(rig, yes=False, otherwise="call it from a terminal, when you have looked at it")
    if (reason := commissioning.latch.reason()) is None:
        click.echo(f"{rig} is not latched")
        return
    click.echo(f"it is latched: {reason}")
    if not dialogue.agrees("did you look at it, and is it free to move?"):
        click.echo("it stays latched")
        return
    commissioning.latch.clear()
    click.echo(f"{commissioning.latch.path} is removed; its axes may have to be homed")


def _opened(
    rig: Path, *, yes: bool, otherwise: str = "say `--yes` to agree to every motion"
) -> tuple["Commissioning", "Dialogue"]:
    from stage_hardware.rig.commissioning.dialogue import Dialogue
    from stage_hardware.rig.commissioning.record import Commissioning

    def agrees(question: str) -> bool:
        if yes:
            click.echo(question)
            return True
        try:
            return click.confirm(question)
        except click.Abort:
            if sys.stdin.isatty():
                raise
            raise NeuroroboError(f"there is nobody to answer; {otherwise}") from None

    def answer(question: str) -> str:
        return "" if yes else str(click.prompt(question, default="", show_default=False))

    return Commissioning(rig), Dialogue(click.echo, agrees, answer)


def _quantity(option: str, text: str, unit: str) -> float:
    """Return a length, a load or the like that was typed, above 0."""
    from neurorobo.units import UnitError, parse_quantity

    try:
        number = parse_quantity(text, unit)
    except UnitError as error:
        raise NeuroroboError(f"{option} {text}: {error}") from error
    if number <= 0:
        raise NeuroroboError(f"{option} {text}: must be greater than 0")
    return number


def _limit_mN(commissioning: "Commissioning", text: str | None) -> float:
    """Return the limit that was typed, or that of `home`."""
    if text is not None:
        return _quantity("--limit", text, "mN")
    commissioning.require("home")
    assert commissioning.record.home is not None
    return commissioning.record.home.limit_mN


def _touch(
    commissioning: "Commissioning", axis: str, until: str | None, within: str, step: str, limit_mN: float
) -> "Touch":
    from stage_hardware.rig.commissioning.home import chosen
    from stage_hardware.rig.commissioning.moves import Touch

    chosen(commissioning, [axis])
    load_mN = commissioning.least_contact_mN() if until is None else _quantity("--until", until, "mN")
    if load_mN > limit_mN / 2:
        raise NeuroroboError(
            f"contact would be a load of {load_mN:.4g} mN, too near to the limit of {limit_mN:.4g} mN; lower "
            "`--until`, or raise `--limit` if the parts bear it"
        )
    return Touch(axis, load_mN, _quantity("--within", within, "um"), _quantity("--step", step, "um"))


def _tell(commissioning: "Commissioning", step: str) -> None:
    click.echo(f"written: {commissioning.file}")
    click.echo(f"next: {step}")
