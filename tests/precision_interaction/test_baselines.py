import math
import runpy
from itertools import pairwise
from pathlib import Path

import pytest
import torch
from precision_interaction.baselines.fixed_plans import FixedStepPlanner, TrapezoidPlanner
from precision_interaction.baselines.fixed_plans_config import FixedStepConfig, TrapezoidConfig
from precision_interaction.baselines.pid import PidCompensator, pid, pid_start
from precision_interaction.baselines.pid_config import PidConfig
from precision_interaction.baselines.pid_tuning import (
    Gains,
    UltimateGain,
    compensation_test,
    grid_search,
    pid_controller,
    teacher_controller,
    ultimate_gain,
    ziegler_nichols,
)
from precision_interaction.teachers.compensators import predictive, profile
from precision_interaction.teachers.compensators_config import PredictiveConfig, ProfileConfig
from precision_interaction.teachers.planner_config import PlannerConfig
from torch import Tensor

from neurorobo.clock import Clock
from neurorobo.config.experiment import load_experiment
from neurorobo.regions import RegionConfig

CLOCK = Clock({"control": 10**9, "radial": 10**9}, spike_step_ns=10**6, window=50)


def pair(x: float, y: float = 0.0) -> Tensor:
    return torch.tensor([[x, y]])


def test_the_pi_controller_is_the_incremental_law_of_ref_3() -> None:
    """du = 0.5 (e - e') + 0.3 e, move = u / M."""
    errors = [30.0, -12.0, 50.0, 8.0, -40.0]
    region = PidCompensator(PidConfig(), CLOCK, torch.Generator())
    state, u, before = region.init_state(1), 0.0, 0.0
    for error in errors:
        u += 0.5 * (error - before) + 0.3 * error
        before = error
        inputs = {"force": pair(error)} | {name: pair(7.0) for name in ("velocity", "mean", "variance")}
        outputs, state = region.step(inputs, state)
        assert outputs["move"][0, 0].item() == pytest.approx(u / 80, abs=1e-6)
        assert outputs["residual"][0, 0].item() == pytest.approx(error - u, abs=1e-4)


def test_a_proportional_gain_of_one_is_the_compensation_of_ref_7() -> None:
    state = pid_start(pair(0.0))
    for force in (pair(40.0, -20.0), pair(-8.0, 100.0)):
        got, state = pid(force, state, kp=1.0, ki=0.0, kd=0.0, period_s=1.0, stiffness_mN_um=80.0)
        torch.testing.assert_close(got.move_um, force / 80)
        torch.testing.assert_close(got.residual_mN, 0 * force)


def test_the_derivative_acts_on_the_change_of_the_error() -> None:
    state = pid_start(pair(0.0))
    moves = []
    for force in (pair(16.0), pair(24.0), pair(24.0)):
        got, state = pid(force, state, kp=0.0, ki=0.0, kd=0.5, period_s=1.0, stiffness_mN_um=80.0)
        moves.append(got.move_um[0, 0].item())
    assert moves == pytest.approx([0.1, 0.05, 0.0])


def test_a_limited_controller_keeps_the_acceleration_and_does_not_wind_up() -> None:
    force, state = pair(2000.0), pid_start(pair(0.0))
    before = state["velocity"]
    smallest = 2000.0
    for _ in range(100):
        got, state = pid(
            force, state, kp=0.5, ki=0.05, kd=0.0, period_s=0.2, stiffness_mN_um=80.0, max_acceleration_um_s2=20.0
        )
        assert (got.velocity_um_s - before).abs().max().item() <= 20 / math.sqrt(2) * 0.2 + 1e-5
        before, force = got.velocity_um_s, got.residual_mN
        smallest = min(smallest, force[0, 0].item())
    assert abs(force[0, 0].item()) < 1.0
    assert smallest > -2000.0


@pytest.mark.parametrize(
    ("region", "first_speed", "moves"),
    [
        (TrapezoidPlanner(TrapezoidConfig(), CLOCK, torch.Generator()), 20.0, 25),
        (FixedStepPlanner(FixedStepConfig(), CLOCK, torch.Generator()), 20.0, 103),
    ],
)
def test_the_plans_without_forces_land_on_the_end(
    region: TrapezoidPlanner | FixedStepPlanner, first_speed: float, moves: int
) -> None:
    initial = {name: torch.tensor([port.initial or (0.0,)]) for name, port in region.config.inputs(CLOCK).items()}
    inputs = {**initial, "remaining": torch.tensor([[2050.0]])}
    speeds = []
    while inputs["remaining"].item() > 1e-3:
        outputs, _ = region.step(inputs, {})
        speeds.append(outputs["speed"].item())
        inputs = {**inputs, "speed": outputs["speed"], "remaining": inputs["remaining"] - outputs["speed"]}
    assert len(speeds) == moves
    assert speeds[0] == first_speed
    assert max(speeds) <= 100
    assert sum(speeds) == pytest.approx(2050, abs=1e-3)
    assert all(abs(b - a) <= 20 + 1e-3 for a, b in pairwise(speeds))


def ports(config: RegionConfig) -> tuple[dict[str, tuple[str, int]], dict[str, tuple[str, int]]]:
    ins, outs = config.inputs(CLOCK), config.outputs(CLOCK)
    return {n: (p.unit, p.width) for n, p in ins.items()}, {n: (p.unit, p.width) for n, p in outs.items()}


def test_compensators_and_planners_can_stand_in_for_each_other() -> None:
    assert ports(PidConfig()) == ports(PredictiveConfig()) == ports(ProfileConfig())
    assert ports(TrapezoidConfig()) == ports(FixedStepConfig()) == ports(PlannerConfig())


def test_a_baseline_needs_no_wires_for_what_it_does_not_look_at() -> None:
    needed = {
        type(config).__name__: {name for name, port in config.inputs(CLOCK).items() if port.initial is None}
        for config in (PidConfig(), TrapezoidConfig(), FixedStepConfig())
    }
    assert needed == {"PidConfig": {"force"}, "TrapezoidConfig": {"remaining"}, "FixedStepConfig": {"remaining"}}


# --- tuning


@pytest.mark.parametrize("period_s", [0.05, 0.1, 0.2, 0.5, 1.0])
def test_the_ultimate_gain_of_an_unsaturated_loop_is_the_analytic_one(period_s: float) -> None:
    """f' = (1 - K) f swings for ever at K = 2, every second period."""
    found = ultimate_gain(period_s=period_s, start_mN=0.1)
    assert found.gain == pytest.approx(2.0, abs=0.011)
    assert found.period_s == pytest.approx(2 * period_s)


def test_the_rule_of_ziegler_and_nichols_by_hand() -> None:
    gains = ziegler_nichols(UltimateGain(2.0, 1.6), period_s=0.2)
    assert tuple(gains) == pytest.approx((1.2, 1.2 * 0.2 / 0.8, 1.2 * 0.2 / 0.2))


def test_the_grid_search_finds_better_gains_than_the_rule_and_predictive_beats_both() -> None:
    tuned = grid_search(torch.Generator().manual_seed(1000))
    force_mN = {
        name: compensation_test(controller, torch.Generator().manual_seed(0)).mean().item()
        for name, controller in {
            "rule": pid_controller(ziegler_nichols(ultimate_gain())),
            "grid": pid_controller(tuned),
            "predictive": teacher_controller(predictive),
            "profile": teacher_controller(profile),
        }.items()
    }
    assert force_mN["predictive"] < force_mN["grid"] < force_mN["rule"]
    assert force_mN["profile"] == pytest.approx(79, abs=4)
    assert force_mN["predictive"] == pytest.approx(6.4, abs=0.5)


EXAMPLE = Path(__file__).parents[2] / "examples" / "baseline_pid.yaml"


def test_the_example_has_the_gains_that_the_grid_search_finds_for_its_period() -> None:
    experiment = load_experiment(EXAMPLE)
    controller = experiment.regions["controller"]
    assert isinstance(controller, PidConfig)
    found = grid_search(torch.Generator().manual_seed(1000), period_s=controller.period_s(experiment.clock))
    assert (controller.kp, controller.ki, controller.kd) == pytest.approx(tuple(found))


def test_the_gains_called_ziegler_and_nichols_are_those_of_the_rule() -> None:
    """In the example's comment, and in the row of the published figures that sets them."""
    period_s = load_experiment(EXAMPLE).clock.seconds("radial")
    rule = ziegler_nichols(ultimate_gain(period_s=period_s), period_s=period_s)
    figures = runpy.run_path(str(EXAMPLE.parents[1] / "benchmarks" / "assembly" / "figures.py"))
    controller = load_experiment(EXAMPLE, figures["ZIEGLER_NICHOLS"]).regions["controller"]
    assert isinstance(controller, PidConfig)
    assert (controller.kp, controller.ki, controller.kd) == pytest.approx(tuple(rule))
    comment = " ".join(line.removeprefix("#").strip() for line in EXAMPLE.read_text().splitlines() if line[:1] == "#")
    assert f"rule gives kp: {rule.kp:g}, ki: {rule.ki:g}, kd: {rule.kd:g}." in comment


def test_every_controller_in_the_test_meets_the_same_draws() -> None:
    two = pid_controller(Gains(torch.tensor([0.5, 0.5])[:, None, None], 0.1, 0.0))
    first, second = compensation_test(two, torch.Generator().manual_seed(3), copies=2)
    torch.testing.assert_close(first, second)
