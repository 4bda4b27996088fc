"""``neurorobo rig calibrate``: find where episodes begin, and write the rig file and the body that begin there."""

from collections.abc import Mapping
from pathlib import Path
from statistics import fmean
from typing import Any

from neurorobo.config import document
from neurorobo.errors import NeuroroboError
from neurorobo.files import write_whole
from neurorobo.units import UnitError, format_quantity, parse_quantity
from stage_hardware.rig.commissioning.dialogue import Dialogue
from stage_hardware.rig.commissioning.home import home_again
from stage_hardware.rig.commissioning.moves import Moves, Touch
from stage_hardware.rig.commissioning.record import Calibrate, Commissioning, Identify
from stage_hardware.rig.rig_config import RigConfig
from stage_hardware.rig.written import refuse_to_replace

MARK = "# Written by `neurorobo rig calibrate`"
BODY_HEAD = f"""{MARK}: what stands under `body:` of an experiment. The loads follow from the `--limit` of the
# commissioning, `age` from the slowest readings: see what your parts bear, and what your task needs, before you use it.
"""
JOG = "are the parts where episodes begin? Jog, such as `x 10 um`, or press Enter if they are"


def calibrate(
    commissioning: Commissioning,
    dialogue: Dialogue,
    limit_mN: float,
    touch: Touch,
    *,
    times: int,
    clearance_um: float,
    out: Path,
) -> None:
    """Go to the start, jog, touch several times, and write the rig whose start is ``clearance_um`` before contact.

    Raises a NeuroroboError if the contacts are further apart than half of ``clearance_um``, a DeclinedError where a
    person does not agree, and a SafetyError if something stops the rig.
    """
    commissioning.require("identify")
    config = commissioning.config
    body_file = out.with_suffix(".body.yaml")
    for file in (out, body_file):
        refuse_to_replace(file, MARK, "neurorobo rig calibrate")
    with Moves(commissioning, dialogue, limit_mN) as moves:
        home_again(commissioning, moves)
        moves.ask("go to where episodes begin, by the rig file? The touching axis goes last.")
        moves.go_to_start(last=touch.axis)
        _jog(moves, dialogue)
        here_um = moves.positions_um()
        moves.ask(
            f"move {touch.axis} on until the load is {touch.load_mN:.4g} mN, by {touch.within_um:g} um at most, "
            f"{times} times?"
        )
        touches_um = []
        for _ in range(times):
            at_um = moves.touch(touch)
            dialogue.say(f"{touch.axis}: contact at {at_um:g} um")
            touches_um.append(at_um)
            moves.go_back_to({touch.axis: here_um[touch.axis]})
    if (scatter_um := max(touches_um) - min(touches_um)) > clearance_um / 2:
        raise NeuroroboError(
            f"{touch.axis}: contacts are {scatter_um:.3g} um apart, too much for a start {clearance_um:g} um before "
            "contact; find out what gives way, take smaller steps (`--step`), or stay further away (`--clearance`)"
        )
    begins_um = {**here_um, touch.axis: fmean(touches_um) - clearance_um}
    start_um = {key: axis.nearest_step(axis.frame.to_axis(begins_um[key])) for key, axis in config.axes.items()}
    commissioning.record.calibrate = Calibrate(start_um=start_um, touches_um=touches_um)
    commissioning.save()
    calibrated = _starting_at(config, start_um, out)
    write_whole(out, f"{MARK} from {commissioning.path}; comments are not carried over.\n{calibrated}".encode())
    body = _body(commissioning, out, limit_mN, touch.axis, clearance_um)
    write_whole(body_file, f"{BODY_HEAD}{document.dump(body)}".encode())
    dialogue.say(f"rig file: {out}\nbody of an experiment: {body_file}")
    if "radial" not in body:
        dialogue.say(
            f"`radial`, `force` and `force_signs` are left out: it is not known which components follow two axes "
            f"beside {touch.axis}; see `{commissioning.command('identify', touch.axis)}`"
        )


def _jog(moves: Moves, dialogue: Dialogue) -> None:
    """Let a person move axes by distances until they are where they should be."""
    while answer := moves.answer(JOG).strip():
        axis, _, distance = answer.partition(" ")
        try:
            if axis not in moves.axes:
                raise UnitError(f"there is no axis `{axis}`; there are {', '.join(moves.axes)}")
            target_um = moves.positions_um()[axis] + parse_quantity(distance.strip(), "um")
            lo, hi = moves.limits_um(axis)
            if not lo <= target_um <= hi:
                raise UnitError(f"{axis} would be at {target_um:g} um, beyond {lo:g}..{hi:g} um")
        except UnitError as error:
            dialogue.say(str(error))
            continue
        moves.go_to({axis: target_um})
        dialogue.say(f"{axis}: {moves.positions_um()[axis]:g} um, load {moves.load_mN():.3g} mN")


def _starting_at(config: RigConfig, start_um: Mapping[str, float], out: Path) -> str:
    """Return the rig as YAML, with axes that start elsewhere; a NeuroroboError for one beyond its travel."""
    controllers = {}
    for name, controller in config.controllers.items():
        axes = {}
        for key, axis in controller.axes.items():
            if not axis.travel.lo <= start_um[key] <= axis.travel.hi:
                raise NeuroroboError(
                    f"{out}: not written, as {key} would start at {start_um[key]:g} um, beyond its travel of "
                    f"{axis.travel.lo:g}..{axis.travel.hi:g} um; choose a smaller `--clearance`"
                )
            axes[key] = axis.model_copy(update={"start": start_um[key]})
        controllers[name] = controller.model_copy(update={"axes": axes})
    return config.model_copy(update={"controllers": controllers}).dump()


def _body(commissioning: Commissioning, out: Path, limit_mN: float, axial: str, clearance_um: float) -> dict[str, Any]:
    """Return what stands under `body:` of an experiment, as far as it is known."""
    record = commissioning.record
    assert record.identify is not None
    assert record.check is not None
    found = record.identify
    axes = commissioning.config.axes
    radial = [axis for axis in axes if axis in found.responses and axis != axial]
    body: dict[str, Any] = {
        "rig": str(out),
        "gap": format_quantity(clearance_um, "um"),
        "elevator_resolution": format_quantity(axes[axial].resolution, "um"),
        "axial": axial,
    }
    if len(radial) == 2:
        body |= {
            "radial": radial,
            "stage_resolution": format_quantity(max(axes[axis].resolution for axis in radial), "um"),
            "force": [found.responses[axis].component for axis in radial],
            "force_signs": [-1 if found.responses[axis].stiffness_mN_um > 0 else 1 for axis in radial],
        }
    if axial in found.responses:
        body["axial_force"] = found.responses[axial].component
    limits = {"stop": limit_mN, "latch": 2 * limit_mN}
    safety = {name: format_quantity(round(value, 3), "mN") for name, value in limits.items()}
    safety |= {"rate": format_quantity(round(20 * limit_mN, 3), "mN/s"), "age": f"{record.check.oldest_ms:.0f} ms"}
    free_mN = max(10 * commissioning.noise_mN, limit_mN / 5)
    body |= {
        "following_error": format_quantity(_following_error_um(commissioning, found), "um"),
        "free_force": format_quantity(round(free_mN, 3), "mN"),
        "safety": {"force": safety},
        "overrun": "stop",
    }
    return body


def _following_error_um(commissioning: Commissioning, found: Identify) -> float:
    """Return three times the largest distance that was seen; four steps, and 1 um, at least."""
    axes = commissioning.config.axes.values()
    return round(max(1.0, *(3 * run.off_um for run in found.axes.values()), *(4 * axis.resolution for axis in axes)), 3)
