"""``neurorobo rig identify``: what each axis does when it is sent somewhere, and what the sensor feels of it."""

from collections.abc import Mapping, Sequence

from stage_hardware.rig.commissioning.dialogue import Dialogue
from stage_hardware.rig.commissioning.home import chosen, home_again
from stage_hardware.rig.commissioning.moves import Moves, Touch
from stage_hardware.rig.commissioning.record import Commissioning, FreeRun, Identify, Response

SPEED_MAY_DIFFER_BY = 0.1
IS_FELT = 5.0
"""A slope that exceeds its error as many times is none of noise."""


def identify(
    commissioning: Commissioning,
    dialogue: Dialogue,
    axes: Sequence[str],
    limit_mN: float,
    *,
    way_um: float,
    touch: Touch | None,
    amplitude_um: float,
    times: int,
) -> None:
    """Move ``axes``, or all, where they touch nothing, and then, with a ``touch``, to and fro in contact.

    What was identified before is not done again. Raises a DeclinedError where a person does not agree, and a
    SafetyError if something stops the rig.
    """
    commissioning.require("home")
    record = commissioning.record
    wanted = chosen(commissioning, axes)
    done = record.identify = record.identify or Identify()
    with Moves(commissioning, dialogue, limit_mN) as moves:
        home_again(commissioning, moves)
        for axis in wanted:
            if axis in done.axes:
                dialogue.say(f"{axis}: its free run is known already")
                continue
            here_um = moves.positions_um()[axis]
            from_um, to_um = _free_way(here_um, moves.limits_um(axis), way_um)
            enters = "" if from_um == here_um else f"to {from_um:g} um, where its travel begins, then "
            moves.ask(f"move {axis} from {here_um:g} {enters}to {to_um:g} um and back, twice? It has to touch nothing.")
            moves.go_to({axis: from_um})
            done.axes[axis] = moves.free_run(axis, to_um)
            commissioning.save()
            _tell(dialogue, axis, done.axes[axis], moves.axes[axis].speed)
        if touch is not None:
            felt = _feel(moves, dialogue, wanted, touch, amplitude_um, times)
            found = _assigned(felt)
            taken = {one.component for one in found.values()}
            others = {axis: one for axis, one in done.responses.items() if axis not in wanted}
            done.responses = {axis: one for axis, one in others.items() if one.component not in taken} | found
            commissioning.save()
            for axis in wanted:
                _tell_response(dialogue, axis, done.responses.get(axis))


def _free_way(here_um: float, limits_um: tuple[float, float], way_um: float) -> tuple[float, float]:
    """Return from where to where to go: towards where episodes begin, or from there to the side that is further away.

    An axis whose origin is beyond its travel enters that first.
    """
    lo, hi = limits_um
    from_um = min(max(here_um, lo), hi)
    to_um = 0.0 if abs(from_um) > 1 else (lo if -lo >= hi else hi)  # by less than 1 um, no axis is away
    return from_um, from_um + min(max(to_um - from_um, -way_um), way_um)


def _feel(
    moves: Moves, dialogue: Dialogue, axes: Sequence[str], touch: Touch, amplitude_um: float, times: int
) -> dict[str, dict[str, Response]]:
    """Touch, and return what each component feels of each axis; the touching axis is drawn back at the end."""
    moves.ask("go to where episodes begin? The touching axis goes last.")
    moves.go_to_start(last=touch.axis)
    moves.ask(
        f"move {touch.axis} on until the load is {touch.load_mN:.4g} mN, by {touch.within_um:g} um at most, and each "
        f"of {', '.join(axes)} by {amplitude_um:g} um to and fro there?"
    )
    at_um = moves.touch(touch)
    dialogue.say(f"{touch.axis}: contact at {at_um:g} um from where episodes begin, {moves.load_mN():.3g} mN")
    felt = {axis: moves.responses(axis, amplitude_um, times) for axis in axes}
    moves.go_back_to({touch.axis: 0.0})
    return felt


def _assigned(felt: Mapping[str, Mapping[str, Response]]) -> dict[str, Response]:
    """Return for each axis the component that follows it, each component once, the clearest first."""
    pairs = sorted(
        (abs(one.stiffness_mN_um) / one.error_mN_um, axis, component)
        for axis, components in felt.items()
        for component, one in components.items()
        if abs(one.stiffness_mN_um) > IS_FELT * one.error_mN_um
    )
    found: dict[str, Response] = {}
    taken: set[str] = set()
    for _, axis, component in reversed(pairs):
        if axis not in found and component not in taken:
            found[axis] = felt[axis][component]
            taken.add(component)
    return found


def _tell(dialogue: Dialogue, axis: str, run: FreeRun, speed_um_s: float) -> None:
    dialogue.say(
        f"{axis}: {run.speed_um_s:.4g} um/s, off by {run.off_um:.2g} um at most; after a stop it runs on by "
        f"{run.runs_on_um:.3g} um and is seen to stand after {run.stands_after_ms:.0f} ms"
    )
    if abs(run.speed_um_s / speed_um_s - 1) > SPEED_MAY_DIFFER_BY:
        dialogue.say(f"  the rig file says {speed_um_s:g} um/s: set `speed` there, or the controller's")


def _tell_response(dialogue: Dialogue, axis: str, response: Response | None) -> None:
    if response is None:
        dialogue.say(f"{axis}: no component follows it; a larger `--amplitude`, or a larger load, may show one")
        return
    dialogue.say(
        f"{axis}: {response.component} follows it with {response.stiffness_mN_um:.3g} mN/um "
        f"(+- {response.error_mN_um:.2g})"
    )
