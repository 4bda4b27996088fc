"""PID controllers of the radial force: the PI controller of ref. [3], f / M of ref. [7], and any other gains."""

import math
from collections.abc import Mapping

import torch
from torch import Tensor

from neurorobo.regions.region import Probe, Region, State
from precision_interaction.baselines.pid_config import PidConfig
from precision_interaction.teachers.compensators import Compensation, as_outputs


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
        return as_outputs(compensation), state
