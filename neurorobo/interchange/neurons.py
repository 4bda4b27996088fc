"""Our neurons as nodes of NIR, and nodes of NIR as our neurons.

A LIF node is ``tau dv/dt = v_leak - v + r I``; it fires where ``v > v_threshold``, and then ``v = v_reset``. Solved by
Euler's method in steps of ``dt``, with rest and reset at zero, this is ``v <- decay v + (1 - decay) r I`` with
``decay = 1 - dt / tau``: our neuron, whose potential is ``U = v / ((1 - decay) r)``. We write ``r = 1``, the one
resistance that every library reads alike, and scale the threshold. Sources: Pedersen et al. 2024 (NIR); Eq. 5-7 of Xing
et al.

Where a potential equals the threshold, a neuron of ours that fires `at` it does, and a node of NIR does not. So that
both do, we write a threshold that is lower by a millionth: more than rounding in single precision, less than any
difference that matters. Of neurons that fire `above` their threshold, such as those of every node that was read, the
threshold is written as it is.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from neurorobo.errors import NeuroroboError
from neurorobo.interchange.library import nir

STEP_S = 1e-4
"""The time step of a file that names none: what snnTorch takes for granted, and SpikingJelly unless told otherwise."""

TIE = 2.0**-20
"""By which part a written threshold is lower than ours, so that a potential equal to ours is above it."""

TOLERANCE = 1e-6
"""Numbers that differ by less, in relation to their size, are one that was rounded."""

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Membrane:
    """The numbers of a population: the decay of all, and the threshold of each neuron.

    ``ties_fire`` says whether a neuron fires whose potential equals its threshold.
    """

    decay: float
    thresholds: Floats
    ties_fire: bool = True


def to_node(membrane: Membrane, step_s: float = STEP_S) -> Any:
    """Return the population as a node of NIR: LIF, or IF where nothing leaks."""
    count = len(membrane.thresholds)

    def all_of(value: float) -> NDArray[np.float32]:
        return np.full(count, value, np.float32)

    if membrane.decay == 1:
        return nir().IF(r=all_of(1 / step_s), v_threshold=_written(membrane, 1), v_reset=all_of(0))
    share = 1 - membrane.decay
    return nir().LIF(
        tau=all_of(step_s / share),
        r=all_of(1),
        v_leak=all_of(0),
        v_threshold=_written(membrane, share),
        v_reset=all_of(0),
    )


def _written(membrane: Membrane, gain: float) -> NDArray[np.float32]:
    """Return the thresholds of a node whose potential is ``gain`` times ours."""
    if membrane.ties_fire:
        return (membrane.thresholds * gain * (1 - TIE)).astype(np.float32)
    least = np.nextafter(membrane.thresholds.astype(np.float32), np.float32(np.inf)) * np.float64(gain)  # that fires
    written = least.astype(np.float32)
    return np.where(written < least, written, np.nextafter(written, np.float32(-np.inf)))


def from_node(name: str, node: Any, step_s: float) -> Membrane:
    """Return a LIF or IF node as our population, which fires above its thresholds.

    They are the numbers of single precision, that of the potentials, nearest to the node's.

    Raises a NeuroroboError, which names the node, for what our neurons cannot do.
    """
    kind = type(node).__name__
    values = {key: np.ravel(np.asarray(value)).astype(np.float64) for key, value in vars(node).items() if key in _NAMES}
    for key, value in values.items():
        if not np.isfinite(value).all():
            raise refusal(name, kind, f"`{key}` holds a value that is not a number", "export it again")
    if np.ndim(node.v_threshold) > 1:  # a number alone is that of all neurons
        raise refusal(
            name, kind, f"it is of the shape {np.shape(node.v_threshold)}", "flatten it: populations are rows"
        )
    leak = values.get("v_leak", values["v_reset"])
    thresholds = values["v_threshold"] - leak
    if not np.allclose(values["v_reset"], leak, atol=TOLERANCE * np.abs(thresholds).max()):
        raise refusal(
            name, kind, "it is reset to another potential than it rests at", "give it `v_reset` equal to `v_leak`"
        )
    if kind == "IF":
        decay, gain = 1.0, step_s * values["r"]
    else:
        if (values["tau"] <= 0).any():
            raise refusal(name, kind, "it has a time constant that is not positive", "choose positive ones")
        decays = 1 - step_s / values["tau"]
        decay = _shortest_decay(np.ravel(node.tau)[0], step_s) if abs(decays[0]) > TOLERANCE else 0.0  # nor below zero
        if np.abs(decays - decays[0]).max() > TOLERANCE:
            raise refusal(
                name, kind, "its neurons have several time constants", "make it a node for each, ours have one"
            )
        if not 0 <= decay < 1:
            raise refusal(
                name,
                kind,
                f"its time constant of {values['tau'][0]:g} s is too short for steps of {step_s:g} s",
                "say which step it was made for with `--dt`",
            )
        gain = (1 - decay) * values["r"]
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        thresholds = shortest(thresholds / gain)
    if (gain <= 0).any() or not ((thresholds > 0) & np.isfinite(thresholds)).all():
        raise refusal(
            name,
            kind,
            "it has a resistance or a threshold above rest that is not positive, and fires at rest or never",
            "choose positive ones",
        )
    return Membrane(decay, thresholds, ties_fire=False)


_NAMES = ("tau", "r", "v_leak", "v_threshold", "v_reset")


def refusal(name: str, kind: str, fault: str, cure: str) -> NeuroroboError:
    """Return the error for a node that cannot become ours."""
    return NeuroroboError(f"the node `{name}` ({kind}) cannot be imported: {fault}; {cure}")


def shortest(values: Floats) -> Floats:
    """Return for each value the shortest that is the same in single precision: 0.2 and not 0.2000000476."""
    return np.array([float(str(value)) for value in values.astype(np.float32)])


def _shortest_decay(tau: Any, step_s: float) -> float:
    """Return the decay of the fewest digits that gives this very time constant, in the precision that it has."""
    exact = 1 - step_s / float(tau)
    for digits in range(1, 17):
        decay = float(f"{exact:.{digits}g}")
        if decay < 1 and tau.dtype.type(step_s / (1 - decay)) == tau:
            return decay
    return exact
