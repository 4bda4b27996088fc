"""How an eye answers to a head that turns sinusoidally, cycle by cycle."""

import math
from dataclasses import dataclass

import numpy as np

from neurorobo.bodies import Array


@dataclass(frozen=True)
class Cycle:
    """One cycle: the gain of the reflex, by how much the eye leads, its mean velocity, and the image's slip (rms).

    Where the cycle was in the dark, the slip is not a number.
    """

    gain: float
    phase_deg: float
    offset_deg_s: float
    slip_deg_s: float


def responses(cycles: Array, head_deg_s: Array, eye_deg_s: Array, slip_deg_s: Array) -> list[Cycle]:
    """Return what each whole cycle shows, of samples (time) of one phase at so many ``cycles`` since it began.

    The eye's velocity is regressed on that of the head and on the same a quarter of a cycle earlier, and a constant;
    ``gain`` and ``phase_deg`` are the length and the angle of the two coefficients. A cycle needs four samples.
    """
    if len(cycles) < 2:
        return []
    number = np.floor(cycles + 1e-9).astype(int)
    whole = math.floor(2 * cycles[-1] - cycles[-2] + 1e-9)
    found = []
    for i in range(whole):
        here = number == i
        if here.sum() < 4:
            continue
        angle = 2 * math.pi * cycles[here]
        sine, cosine = np.sin(angle), np.cos(angle)
        fastest = head_deg_s[here] @ sine / (sine @ sine)
        regressors = np.stack([fastest * sine, fastest * cosine, np.ones(here.sum())], axis=1)
        (same, quarter, offset), *_ = np.linalg.lstsq(regressors, eye_deg_s[here], rcond=None)
        rms = float(np.sqrt(np.mean(slip_deg_s[here] ** 2)))
        gain, lead = math.hypot(same, quarter), math.degrees(math.atan2(quarter, same))
        found.append(Cycle(gain, lead, float(offset), rms))
    return found
