"""Fig. 6: the cerebellum compensates a radial force, beside its teachers and PID controllers."""

from collections.abc import Sequence
from typing import ClassVar, get_args

import numpy as np
import torch

from precision_interaction.baselines.pid_tuning import (
    TEST_PERIODS,
    Controller,
    compensation_course,
    grid_search,
    pid_controller,
    teacher_controller,
    ultimate_gain,
    ziegler_nichols,
)
from precision_interaction.reproduce.compensation import (
    COMPENSATE,
    PREPARING_SEED,
    Effort,
    Met,
    Network,
    TeacherName,
    errors_mN,
    held,
    joined,
    network_controller,
    teacher_region,
    train,
    watched,
)
from precision_interaction.reproduce.row import Result, Row, Setting

PERIODS_S = (0.05, 0.1, 0.2, 0.5, 1.0)
PAPER_PERIOD_S = 0.2
NUCLEI = (8, 16, 32, 64)
FURTHER_SEEDS = (2, 3)
TEACHERS: tuple[TeacherName, ...] = get_args(TeacherName)
TEST_SEED = 0
TRAJECTORIES, QUICK_TRAJECTORIES = 100, 4
SHOWN_PERIODS = 2 * TEST_PERIODS
QUICK_EFFORT = Effort(granule_cells=80, purkinje_cells=40, steps=2, batch=4)


class Cerebellum(Row):
    """Mean radial force over the first 20 periods of 100 trajectories, for several control periods and sizes."""

    name: ClassVar[str] = "fig6"
    bystanders: ClassVar[frozenset[str]] = frozenset({"neurorobo.experiment.rollout"})

    def cells(self, setting: Setting) -> Sequence[str]:
        """Return one for teachers and PIDs of each period, and one for each network."""
        return [others_cell(period_s) for period_s in periods(setting)] + [
            network.name for network in networks(setting)
        ]

    def measure(self, cell: str, setting: Setting) -> Result:
        """Train a network and test it, or test teachers and PID controllers."""
        for network in networks(setting):
            if network.name == cell:
                return _measure_network(network, setting)
        [period_s] = [period_s for period_s in periods(setting) if others_cell(period_s) == cell]
        return _measure_others(period_s, setting)


def periods(setting: Setting) -> Sequence[float]:
    """Return the control periods, s."""
    return (PAPER_PERIOD_S, 1.0) if setting.quick else PERIODS_S


def networks(setting: Setting) -> Sequence[Network]:
    """Return what is trained: the paper's size for each period and teacher; for the paper's period larger ones too.

    The paper's size at its period is trained from further seeds.
    """
    more = NUCLEI[1:2] if setting.quick else NUCLEI[1:]
    seeds = () if setting.quick else FURTHER_SEEDS
    return [
        *(Network(teacher, period_s) for teacher in TEACHERS for period_s in periods(setting)),
        *(Network(teacher, PAPER_PERIOD_S, nuclei) for teacher in TEACHERS for nuclei in more),
        *(Network(teacher, PAPER_PERIOD_S, seed=seed) for teacher in TEACHERS for seed in seeds),
    ]


def others_cell(period_s: float) -> str:
    """Return the name of the cell of the teachers and PIDs of a period."""
    return f"teachers and PIDs, {period_s:g} s"


def _measure_network(network: Network, setting: Setting) -> Result:
    region = train(network, QUICK_EFFORT if setting.quick else Effort())
    met: list[Met] = []
    found = _tested(watched(network_controller(region), met), network.period_s, setting)
    errors = errors_mN(region, teacher_region(network), joined(met[:TEST_PERIODS]))
    if network.teacher == "predictive":
        limited = held(network_controller(region), period_s=network.period_s)
        found["held_mean_mN"] = _tested(limited, network.period_s, setting)["mean_mN"]
    return {**found, "move_error_mN": errors["move"], "residual_error_mN": errors["residual"]}


def _measure_others(period_s: float, setting: Setting) -> Result:
    ultimate = ultimate_gain(period_s=period_s)
    rule = ziegler_nichols(ultimate, period_s=period_s)
    best = grid_search(torch.Generator().manual_seed(PREPARING_SEED), period_s=period_s)
    controllers = {
        **{f"{name} teacher": teacher_controller(COMPENSATE[name], period_s=period_s) for name in TEACHERS},
        "Ziegler-Nichols": pid_controller(rule, period_s=period_s),
        "grid search": pid_controller(best, period_s=period_s),
    }
    return {
        **{name: _tested(controller, period_s, setting) for name, controller in controllers.items()},
        "ultimate": {"gain": ultimate.gain, "period_s": ultimate.period_s},
        "gains": {"Ziegler-Nichols": [float(gain) for gain in rule], "grid search": [float(gain) for gain in best]},
    }


def _tested(controller: Controller, period_s: float, setting: Setting) -> dict[str, object]:
    """Return the mean force of each trajectory, the acceleration that is exceeded in 5 % of the periods, the course."""
    met: list[Met] = []
    shown = period_s == PAPER_PERIOD_S
    course_mN = compensation_course(
        watched(controller, met),
        torch.Generator().manual_seed(TEST_SEED),
        trajectories=QUICK_TRAJECTORIES if setting.quick else TRAJECTORIES,
        period_s=period_s,
        periods=SHOWN_PERIODS if shown else TEST_PERIODS,
    )[:, 0]
    change = [each.done.velocity_um_s - each.inputs["velocity"] for each in met[:TEST_PERIODS]]
    found: dict[str, object] = {
        "mean_mN": course_mN[:TEST_PERIODS].mean(0).tolist(),
        "acceleration_um_s2": float(torch.cat(change).abs().flatten().quantile(0.95)) / period_s,
    }
    if shown:
        found["course_mN"] = np.round(course_mN.numpy().astype(float), 1).tolist()
    return found
