"""Honest gains for the PID baselines, and the cerebellum's test that compares compensators (Sec. VI-A, Fig. 6)."""

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from neurorobo.regions.region import State
from precision_interaction import table_one
from precision_interaction.baselines.pid import pid, pid_start
from precision_interaction.teachers.compensators import Compensation
from precision_interaction.teachers.contact_expectation import one_period

Controller = Callable[[Tensor, State, Tensor, Tensor], tuple[Compensation, State]]
"""(force, state, mean, variance) -> (compensation, state); the state holds at least the `velocity`."""

TEST_PERIOD_S = 0.2
TEST_PERIODS = 20
TEST_SPEED_UM_S = 30.0


class Gains(NamedTuple):
    """PID gains per period."""

    kp: float | Tensor
    ki: float | Tensor
    kd: float | Tensor


class UltimateGain(NamedTuple):
    """The least proportional gain that keeps the loop oscillating, and the period of that oscillation."""

    gain: float
    period_s: float


def pid_controller(gains: Gains, *, period_s: float = TEST_PERIOD_S) -> Controller:
    """A PID controller of the paper's rig, within its acceleration limit."""

    def control(force_mN: Tensor, state: State, mean_mN: Tensor, variance_mN2: Tensor) -> tuple[Compensation, State]:
        return pid(
            force_mN,
            state,
            kp=gains.kp,
            ki=gains.ki,
            kd=gains.kd,
            period_s=period_s,
            stiffness_mN_um=table_one.STIFFNESS_MN_UM,
            max_acceleration_um_s2=table_one.MAX_ACCELERATION_UM_S2,
        )

    return control


def teacher_controller(compensate: Callable[..., Compensation], *, period_s: float = TEST_PERIOD_S) -> Controller:
    """`compensators.profile` or `compensators.predictive` as a controller."""

    def control(force_mN: Tensor, state: State, mean_mN: Tensor, variance_mN2: Tensor) -> tuple[Compensation, State]:
        compensation = compensate(force_mN, state["velocity"], mean_mN, variance_mN2, period_s=period_s)
        return compensation, {**state, "velocity": compensation.velocity_um_s}

    return control


def compensation_test(
    controller: Controller,
    generator: torch.Generator,
    *,
    trajectories: int = 100,
    copies: int = 1,
    period_s: float = TEST_PERIOD_S,
) -> Tensor:
    """The cerebellum's test: the mean norm of the radial force (mN) of each trajectory, (copies, trajectories)."""
    return compensation_course(controller, generator, trajectories=trajectories, copies=copies, period_s=period_s).mean(
        dim=0
    )


def compensation_course(
    controller: Controller,
    generator: torch.Generator,
    *,
    trajectories: int = 100,
    copies: int = 1,
    period_s: float = TEST_PERIOD_S,
    periods: int = TEST_PERIODS,
) -> Tensor:
    """The norm of the radial force (mN) at the end of each period of the test, (periods, copies, trajectories).

    Forces start in 64..80 mN and velocities in -2..0 um/s per axis, the axis moves at 30 um/s, the contact is drawn
    from the proportional law. Every copy gets the same draws, so that controllers with gains (copies, 1, 1) compare on
    equal terms; a longer test begins with the draws of a shorter one.
    """
    shape = (trajectories, 2)
    force_mN = (64.0 + 16.0 * torch.rand(shape, generator=generator)).expand(copies, *shape)
    velocity_um_s = (-2.0 * torch.rand(shape, generator=generator)).expand(copies, *shape)
    mean_mN, variance_mN2 = one_period(torch.tensor([TEST_SPEED_UM_S]), period_s=period_s)
    state = pid_start(force_mN, velocity_um_s)
    course_mN = []
    for _ in range(periods):
        compensation, state = controller(force_mN, state, mean_mN, variance_mN2)
        noise = torch.randn(shape, generator=generator)
        force_mN = compensation.residual_mN + mean_mN + variance_mN2.sqrt() * noise
        course_mN.append(force_mN.norm(dim=-1))
    return torch.stack(course_mN)


def ultimate_gain(
    *, period_s: float = TEST_PERIOD_S, start_mN: float = 72.0, largest: float = 4.0, candidates: int = 400
) -> UltimateGain:
    """The ultimate-gain test: raise the proportional gain until the loop, pushed by start_mN, never comes to rest.

    Without noise and contact, within the acceleration limit. Every gain is tried at once and the smallest taken
    that still swings as widely at the end of 400 periods as half-way.
    """
    gains = torch.linspace(largest / candidates, largest, candidates)[:, None]
    force_mN = torch.full_like(gains, start_mN)
    controller = pid_controller(Gains(gains, 0.0, 0.0), period_s=period_s)
    state, zero = pid_start(force_mN), torch.zeros_like(force_mN)
    course = []
    for _ in range(400):
        compensation, state = controller(force_mN, state, zero, zero)
        force_mN = compensation.residual_mN
        course.append(force_mN[:, 0])
    swing = torch.stack(course)
    halfway, end = swing[150:250].abs().amax(0), swing[300:].abs().amax(0)
    sustained = (end > 0.01 * start_mN) & (end > 0.99 * halfway)
    first = int(sustained.int().argmax())
    late = swing[200:, first]
    upward = torch.nonzero((late[:-1] < 0) & (late[1:] >= 0))[:, 0]
    cycles = len(upward) - 1
    return UltimateGain(gains[first].item(), float(upward[-1] - upward[0]) / cycles * period_s)


def ziegler_nichols(ultimate: UltimateGain, *, period_s: float = TEST_PERIOD_S) -> Gains:
    """The classic rule: 0.6 of the ultimate gain, integral time 1/2 and derivative time 1/8 of the ultimate period."""
    kp = 0.6 * ultimate.gain
    return Gains(kp, kp * period_s / (ultimate.period_s / 2), kp * (ultimate.period_s / 8) / period_s)


def grid_search(generator: torch.Generator, *, period_s: float = TEST_PERIOD_S) -> Gains:
    """The gains of least mean force in the cerebellum's test, over a grid of kp 0..2, ki 0..1 and kd 0..1."""
    axes = torch.linspace(0, 2, 21), torch.linspace(0, 1, 21), torch.linspace(0, 1, 11)
    kp, ki, kd = (values.reshape(-1, 1, 1) for values in torch.meshgrid(*axes, indexing="ij"))
    controller = pid_controller(Gains(kp, ki, kd), period_s=period_s)
    force_mN = compensation_test(controller, generator, copies=len(kp), period_s=period_s).mean(dim=1)
    best = int(force_mN.argmin())
    return Gains(kp[best].item(), ki[best].item(), kd[best].item())
