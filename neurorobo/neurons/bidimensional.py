"""Neurons of two variables, whose upstroke is part of their dynamics: Izhikevich's and the exponential one."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from neurorobo.neurons.exponential import MOST, exponential
from neurorobo.neurons.surrogate import Surrogate

if TYPE_CHECKING:
    from torch import Tensor

MOST_SUBSTEPS = 64


@dataclass(frozen=True)
class Izhikevich:
    """Izhikevich's simple model: a quadratic potential and a recovery variable.

    ::

        dV/dt = 0.04 V² + 5 V + 140 - u + input_gain I
        du/dt = a (b V - u)
        where V reaches peak_mV: a spike, V <- c, u <- u + d

    ``V`` and ``c`` are in mV, time in ms. One step of ``step_ms`` takes ``substeps`` of Euler's method, in which ``u``
    sees the new ``V``, as in the published program (which updates ``u`` once a millisecond, and ``V`` twice). An
    upstroke is cut off at its peak, and a neuron that is there when the step ends fires: at most once a step.
    The state (batch, 2 x neurons) is ``V``, then ``u``. Source: Izhikevich 2003. The surrogate's width is in mV.
    """

    a: float = 0.02
    b: float = 0.2
    c: float = -65.0
    d: float = 8.0
    input_gain: float = 1.0
    peak_mV: float = 30.0
    step_ms: float = 1.0
    substeps: int = 2
    surrogate: Surrogate = Surrogate("fast_sigmoid", 20.0)

    def __post_init__(self) -> None:
        """Refuse numbers that are not finite, a reset above the peak, and steps that are none."""
        _check_steps(self.step_ms, self.substeps)
        for name in ("a", "b", "c", "d", "input_gain", "peak_mV"):
            if not math.isfinite(getattr(self, name)):
                raise ValueError(f"`{name}` is a finite number, got {getattr(self, name)}")
        if not self.c < self.peak_mV:
            raise ValueError(f"the reset `c` lies below the peak of {self.peak_mV} mV, got {self.c}")

    @property
    def resting_state(self) -> tuple[float, float]:
        """Where ``V`` and ``u`` stay without a current, or ``c`` and ``b c`` of neurons that fire by themselves."""
        slope = 5 - self.b
        inside = slope**2 - 4 * 0.04 * 140
        potential = self.c if inside < 0 else (-slope - math.sqrt(inside)) / 0.08
        return potential, self.b * potential

    def at_rest(self, batch: int, neurons: int) -> "Tensor":
        """Return the resting state (batch, 2 x neurons)."""
        return _resting(self.resting_state, batch, neurons)

    def step(self, current: "Tensor", state: "Tensor") -> "tuple[Tensor, Tensor]":
        """Advance one step: input (batch, neurons) and state -> spikes 0/1 and the next state."""
        import torch

        potential, recovery = state.chunk(2, dim=1)
        drive = current * self.input_gain
        substep = self.step_ms / self.substeps
        for number in range(1, self.substeps + 1):
            change = (potential * 0.04 + 5) * potential + 140 - recovery + drive
            potential = _at_most(potential + change * substep, self.peak_mV, last=number == self.substeps)
            recovery = recovery + (potential * self.b - recovery) * (self.a * substep)
        spikes = self.surrogate.fire(potential - self.peak_mV)
        return spikes, torch.cat([potential * (1 - spikes) + spikes * self.c, recovery + spikes * self.d], dim=1)


@dataclass(frozen=True)
class AdEx:
    """The adaptive exponential integrate-and-fire neuron.

    ::

        C dV/dt   = g_L (E_L - V) + g_L Δ_T exp((V - V_T) / Δ_T) - w + input_gain I
        τ_w dw/dt = a (V - E_L) - w
        where V reaches peak_mV: a spike, V <- reset_mV, w <- w + b

    In pF, nS, mV, ms and pA. One step of ``step_ms`` takes ``substeps`` of Euler's method, in which ``w`` sees the new
    ``V``. An upstroke is cut off at its peak, and a neuron that is there when the step ends fires: at most once a step.
    The state (batch, 2 x neurons) is ``V``, then ``w``. Source: Brette & Gerstner 2005, whose cell the defaults are.
    The surrogate's width is in mV.
    """

    capacitance_pF: float = 281.0
    leak_nS: float = 30.0
    rest_mV: float = -70.6
    slope_mV: float = 2.0
    threshold_mV: float = -50.4
    time_constant_ms: float = 144.0
    a_nS: float = 4.0
    b_pA: float = 80.5
    reset_mV: float = -70.6
    input_gain: float = 1.0
    peak_mV: float = -30.4
    step_ms: float = 1.0
    substeps: int = 10
    surrogate: Surrogate = Surrogate("fast_sigmoid", 5.0)

    def __post_init__(self) -> None:
        """Refuse numbers that are not finite or of the wrong sign, a reset above the peak, and steps that are none."""
        _check_steps(self.step_ms, self.substeps)
        for name in ("capacitance_pF", "leak_nS", "slope_mV", "time_constant_ms"):
            if not 0 < getattr(self, name) < math.inf:
                raise ValueError(f"`{name}` is positive and finite, got {getattr(self, name)}")
        for name in ("rest_mV", "threshold_mV", "a_nS", "b_pA", "reset_mV", "input_gain", "peak_mV"):
            if not math.isfinite(getattr(self, name)):
                raise ValueError(f"`{name}` is a finite number, got {getattr(self, name)}")
        if not self.reset_mV < self.peak_mV:
            raise ValueError(f"`reset_mV` lies below the peak of {self.peak_mV} mV, got {self.reset_mV}")
        if (self.peak_mV - self.threshold_mV) / self.slope_mV > MOST:
            raise ValueError(
                f"at a peak of {self.peak_mV} mV the exponential is no number any more; it lies at most {MOST:.0f} "
                f"slopes of {self.slope_mV} mV above the threshold of {self.threshold_mV} mV"
            )

    @property
    def resting_state(self) -> tuple[float, float]:
        """The ``V`` and ``w`` of neurons that have heard nothing."""
        return self.rest_mV, 0.0

    def at_rest(self, batch: int, neurons: int) -> "Tensor":
        """Return the resting state (batch, 2 x neurons)."""
        return _resting(self.resting_state, batch, neurons)

    def step(self, current: "Tensor", state: "Tensor") -> "tuple[Tensor, Tensor]":
        """Advance one step: input (batch, neurons) and state -> spikes 0/1 and the next state."""
        import torch

        potential, adaptation = state.chunk(2, dim=1)
        drive = current * self.input_gain
        substep = self.step_ms / self.substeps
        for number in range(1, self.substeps + 1):
            upstroke = exponential((potential - self.threshold_mV) * (1 / self.slope_mV))
            change = (self.rest_mV - potential) * self.leak_nS + upstroke * (self.leak_nS * self.slope_mV)
            change = change - adaptation + drive
            potential = potential + change * (substep / self.capacitance_pF)
            potential = _at_most(potential, self.peak_mV, last=number == self.substeps)
            aim = (potential - self.rest_mV) * self.a_nS
            adaptation = adaptation + (aim - adaptation) * (substep / self.time_constant_ms)
        spikes = self.surrogate.fire(potential - self.peak_mV)
        after = [potential * (1 - spikes) + spikes * self.reset_mV, adaptation + spikes * self.b_pA]
        return spikes, torch.cat(after, dim=1)


def _check_steps(step_ms: float, substeps: int) -> None:
    if not 0 < step_ms < math.inf:
        raise ValueError(f"a step is positive and finite, got {step_ms} ms")
    if not 1 <= substeps <= MOST_SUBSTEPS:
        raise ValueError(f"a step has 1 to {MOST_SUBSTEPS} substeps, got {substeps}")


def _resting(values: tuple[float, float], batch: int, neurons: int) -> "Tensor":
    import torch

    return torch.tensor(values).repeat_interleave(neurons).repeat(batch, 1)


def _at_most(potential: "Tensor", peak: float, *, last: bool) -> "Tensor":
    """Return potentials (batch, neurons), cut off at their peak; of the last substep with the gradient of those above.

    Without it, neurons that fire would learn nothing; earlier on, it would be that of an upstroke, which is boundless.
    """
    cut = potential.clamp(max=peak)
    return cut.detach() + (potential - potential.detach()) if last else cut
