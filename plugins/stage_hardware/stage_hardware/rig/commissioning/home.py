"""``neurorobo rig home``: let each axis look for its origin, one after the other."""

from collections.abc import Sequence

from neurorobo.errors import NeuroroboError, did_you_mean
from stage_hardware.rig.commissioning.dialogue import Dialogue
from stage_hardware.rig.commissioning.moves import Moves
from stage_hardware.rig.commissioning.record import Commissioning, Home


def home(commissioning: Commissioning, dialogue: Dialogue, axes: Sequence[str], limit_mN: float) -> None:
    """Home ``axes`` in this order; without any, those that do not know where they are and were not homed yet.

    Raises a DeclinedError where a person does not agree, and a SafetyError if something stops the rig.
    """
    commissioning.require("check")
    done = commissioning.record.home = commissioning.record.home or Home(limit_mN=limit_mN)
    done.limit_mN = limit_mN
    wanted = [axis for axis in chosen(commissioning, axes) if axes or axis not in done.took_s]
    if not wanted:
        dialogue.say("all axes were homed before; name one with `--axis` to home it again")
        return
    with Moves(commissioning, dialogue, limit_mN) as moves:
        for axis in wanted:
            if moves.referenced()[axis] and axis not in axes:
                dialogue.say(f"{axis}: knows where it is, by its controller's account")
                done.took_s.setdefault(axis, 0.0)
            else:
                can = moves.axes[axis]
                moves.ask(
                    f"home {axis}? It looks for its origin at up to {can.speed:g} {can.unit}/s, and may go "
                    f"{can.hi - can.lo:g} {can.unit} and on to its switches, either way. Is the way free?"
                )
                done.took_s[axis] = moves.home(axis)
                dialogue.say(f"{axis}: found its origin within {done.took_s[axis]:.1f} s")
            commissioning.save()
    if missing := missing_axes(commissioning):
        dialogue.say(f"not homed yet: {', '.join(missing)}")


def home_again(commissioning: Commissioning, moves: Moves) -> None:
    """Home the axes that do not know where they are, in the order of `home`.

    Many controllers do not say it of themselves, and a new program has to begin with it. Raises a NeuroroboError if an
    axis was never homed.
    """
    commissioning.require("home")
    if missing := missing_axes(commissioning):
        cure = f"go on with `{commissioning.command('home')}`"
        raise NeuroroboError(f"{commissioning.path}: {', '.join(missing)} was not homed yet; {cure}")
    assert commissioning.record.home is not None
    known = moves.referenced()
    if lost := [axis for axis in commissioning.record.home.took_s if not known[axis]]:
        moves.ask(f"home {', '.join(lost)} first, one after the other? Their controllers do not say where they are.")
        for axis in lost:
            moves.home(axis)


def missing_axes(commissioning: Commissioning) -> list[str]:
    """Return the axes that were not homed yet."""
    done = commissioning.record.home
    return [axis for axis in chosen(commissioning, ()) if done is None or axis not in done.took_s]


def chosen(commissioning: Commissioning, axes: Sequence[str]) -> list[str]:
    """Return ``axes``, or all axes of the rig; a NeuroroboError for one that is not there."""
    there = commissioning.config.axes
    for axis in axes:
        if axis not in there:
            raise NeuroroboError(f"{commissioning.path}: the rig has no axis `{axis}`{did_you_mean(axis, there)}")
    return list(axes or there)
