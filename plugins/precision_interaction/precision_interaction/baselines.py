"""What the paper compares with: fixed steps and PI (ref. [3]), trapezoid and f / M (ref. [7]), PID controllers."""

import math
from collections.abc import Mapping

import torch
from torch import Tensor

from neurorobo.regions.region import Probe, Region, State
from precision_interaction import compensators, planner
from precision_interaction.analytic_configs import AxialPlannerConfig, FixedStepConfig, PidConfig, TrapezoidConfig
from precision_interaction.compensators import Compensation


def pid_start(force_mN: Tensor, velocity_um_s: Tensor | None = None) -> State:
    """Return the state of `pid` at its start, for forces of this shape: no error, velocity 0 unless given."""
    zero = torch.zeros_like(force_mN)
    return {"error": zero, "integral": zero, "velocity": zero if velocity_um_s is None else velocity_um_s}


def pid(
    force_mN: Tensor,
    state: State,
    *,
    kp: float | Tensor,
    ki: float | Tensor,
    kd: float | Tensor,
    period_s: float,
    stiffness_mN_um: float,
    max_acceleration_um_s2: float | None = None,
) -> tuple[Compensation, State]:
    """PID of the radial force e (batch, 2): the move is (kp e + ki sum(e) + kd (e - e')) / M, gains per period.

    From its start this is the incremental law du = kp (e - e') + ki e of the paper's ref. [3]. The state holds the
    error and integral (mN) and the velocity (um/s). Each axis gets 1/sqrt(2) of the acceleration; where that limits
    the move, the integral stands still.
    """
    integral_mN = state["integral"] + ki * force_mN
    wanted_mN = kp * force_mN + integral_mN + kd * (force_mN - state["error"])
    wanted_um_s = wanted_mN / (stiffness_mN_um * period_s)
    velocity_um_s = wanted_um_s
    if max_acceleration_um_s2 is not None:
        change = max_acceleration_um_s2 / math.sqrt(2.0) * period_s
        velocity_um_s = torch.clamp(wanted_um_s, state["velocity"] - change, state["velocity"] + change)
        integral_mN = torch.where(velocity_um_s == wanted_um_s, integral_mN, state["integral"])
    move_um = velocity_um_s * period_s
    return (
        Compensation(move_um, force_mN - stiffness_mN_um * move_um, velocity_um_s),
        {"error": force_mN, "integral": integral_mN, "velocity": velocity_um_s},
    )


class PidCompensator(Region):
    """The region that computes `pid`; its velocity is its own state, the input of that name is not read."""

    config: PidConfig

    def init_state(self, batch: int) -> State:
        """No errors, no velocity."""
        return pid_start(torch.zeros(batch, 2))

    def step(
        self, inputs: Mapping[str, Tensor], state: State, probe: Probe | None = None
    ) -> tuple[dict[str, Tensor], State]:
        """Plan one radial period's move."""
        compensation, state = pid(
            inputs["force"],
            state,
            kp=self.config.kp,
            ki=self.config.ki,
            kd=self.config.kd,
            period_s=self.config.period_s(self.clock),
            stiffness_mN_um=self.config.stiffness,
            max_acceleration_um_s2=self.config.max_acceleration,
        )
        return compensators.as_outputs(compensation), state


def _without_forces(
    config: AxialPlannerConfig, period_s: float, wanted_um_s: Tensor, inputs: Mapping[str, Tensor]
) -> dict[str, Tensor]:
    """Outputs of a planner that looks at no force: it brakes for the end, is always confident and keeps beta."""
    stopping_um_s = planner.stopping_speed(
        inputs["remaining"], period_s=period_s, max_acceleration_um_s2=config.max_acceleration
    )
    return {
        "speed": torch.minimum(wanted_um_s, stopping_um_s),
        "beta": inputs["beta"],
        "confidence": torch.ones_like(wanted_um_s),
        "terminal": (wanted_um_s > stopping_um_s).to(wanted_um_s),
    }


class TrapezoidPlanner(Region):
    """Largest acceleration, cruise, largest deceleration, ending on the last micrometre; looks at no force."""

    config: TrapezoidConfig

    def step(
        self, inputs: Mapping[str, Tensor], state: State, probe: Probe | None = None
    ) -> tuple[dict[str, Tensor], State]:
        """Plan one axial move."""
        period_s = self.config.period_s(self.clock)
        wanted_um_s = inputs["speed"] + self.config.max_acceleration * period_s
        return _without_forces(self.config, period_s, wanted_um_s.clamp(max=self.config.max_speed), inputs), state


class FixedStepPlanner(Region):
    """The same distance in every period, the rest in the last; looks at no force."""

    config: FixedStepConfig

    def step(
        self, inputs: Mapping[str, Tensor], state: State, probe: Probe | None = None
    ) -> tuple[dict[str, Tensor], State]:
        """Plan one axial move."""
        period_s = self.config.period_s(self.clock)
        wanted_um_s = torch.full_like(inputs["speed"], min(self.config.distance / period_s, self.config.max_speed))
        return _without_forces(self.config, period_s, wanted_um_s, inputs), state
