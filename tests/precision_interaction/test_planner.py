import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from precision_interaction import table_one
from precision_interaction.teachers.planner import (
    AxialPlanner,
    assessment,
    confidence,
    desired_speed,
    next_beta,
    plan,
    stopping_speed,
)
from precision_interaction.teachers.planner_config import PlannerConfig
from torch import Tensor

from neurorobo.clock import Clock

CLOCK = Clock({"control": 10**9}, spike_step_ns=10**6, window=50)
MAX_UM_S, LIMIT_UM_S2 = table_one.MAX_SPEED_UM_S, table_one.MAX_ACCELERATION_UM_S2
periods = st.sampled_from([0.25, 0.5, 1.0])


def one(value: float) -> Tensor:
    return torch.tensor([[value]], dtype=torch.float64)


def pair(x: float, y: float) -> Tensor:
    return torch.tensor([[x, y]], dtype=torch.float64)


# --- C_a, Eq. 20


@pytest.mark.parametrize(
    ("force_mN", "speed_um_s", "expected"),
    [
        ((0.0, 0.0), 50.0, 1.0),
        ((120.0, 160.0), 100.0, 0.0),  # what gamma_a is chosen for: 200 mN at full speed
        ((0.0, 40.0), 10.0, -0.5),  # 2 / 2^2 - 1
        ((3.0, 4.0), 0.0, 2 * 2 ** (-5 / 4) - 1),  # standing still counts as creeping
    ],
)
def test_the_assessment_by_hand(force_mN: tuple[float, float], speed_um_s: float, expected: float) -> None:
    assert assessment(pair(*force_mN), one(speed_um_s)).item() == pytest.approx(expected)


# --- C_p, Eq. 21-22


def integrated(forecast_mN: tuple[float, float], deviation_mN: tuple[float, float]) -> float:
    """The printed integral of N(forecast, S) over +-sqrt(diag S), over T_p, by the midpoint rule."""

    def within(mean: float, deviation: float) -> float:
        cells = (torch.arange(20_000, dtype=torch.float64) + 0.5) / 10_000 - 1
        density = torch.exp(-(((cells * deviation - mean) / deviation) ** 2) / 2) / math.sqrt(2 * math.pi)
        return density.mean().item() * 2

    return math.prod(map(within, forecast_mN, deviation_mN)) / within(0.0, 1.0) ** 2


@pytest.mark.parametrize(
    ("forecast_mN", "variance_mN2"),
    [((0.0, 0.0), (100.0, 50.0)), ((12.0, -20.0), (350.0, 160.0)), ((-60.0, 5.0), (0.0, 0.0))],
)
def test_the_confidence_is_the_printed_integral(
    forecast_mN: tuple[float, float], variance_mN2: tuple[float, float]
) -> None:
    total = tuple(math.sqrt(variance + 138.0) for variance in variance_mN2)
    got = confidence(pair(*forecast_mN), pair(*variance_mN2), unresolved_variance_mN2=138.0).item()
    assert got == pytest.approx(integrated(forecast_mN, (total[0], total[1])), rel=1e-6)


@given(variance=st.floats(0.0, 1000.0))
def test_a_forecast_of_zero_force_is_certain(variance: float) -> None:
    assert confidence(pair(0.0, 0.0), pair(variance, variance / 2)).item() == pytest.approx(1.0)


@given(x=st.floats(0.0, 60.0), y=st.floats(0.0, 60.0), more=st.floats(0.1, 20.0))
def test_confidence_falls_with_the_forecast_on_either_side(x: float, y: float, more: float) -> None:
    variance = pair(300.0, 100.0)
    assert confidence(pair(x + more, y), variance).item() < confidence(pair(x, y), variance).item()
    torch.testing.assert_close(confidence(pair(x, y), variance), confidence(pair(-x, -y), variance))


def test_the_paper_rig_cannot_resolve_138_mN2() -> None:
    assert pytest.approx(138, abs=0.5) == table_one.UNRESOLVED_VARIANCE_MN2


# --- beta, Eq. 23


@pytest.mark.parametrize(
    ("beta", "current", "expected"), [(0.3, 1.0, 0.6), (0.6, 1.0, 1.0), (0.8, -0.5, 0.4), (0.5, -1.0, 0.0)]
)
def test_beta_by_hand(beta: float, current: float, expected: float) -> None:
    assert next_beta(one(beta), one(current)).item() == pytest.approx(expected)


# --- the speed, Eq. 24-25 and 27


@pytest.mark.parametrize(
    ("speed", "beta", "current", "future", "expected"),
    [
        (2.0, 0.6, 1.0, 1.0, 5.2),  # 2 (1 + 0.6 + 2 (1 - 0.5))
        (30.0, 0.0, 0.5, 0.7, 39.0),  # 30 (1 + 1.5 * 0.2)
        (40.0, 1.0, 1.0, 1.0, 60.0),  # 120, but the acceleration allows 20 more
        (95.0, 1.0, 1.0, 1.0, 100.0),  # the maximum
        (20.0, 0.0, 0.0, 0.0, 10.0),  # 20 (1 - 0.5)
        (60.0, 0.0, 1.0, 0.0, 40.0),  # to a standstill, but the acceleration allows 20 less
        (3.0, 0.0, 1.0, 0.0, 2.0),  # creep
        (0.0, 1.0, 1.0, 1.0, 2.0),  # from standstill, where a factor alone would stay for ever
    ],
)
def test_the_desired_speed_by_hand(speed: float, beta: float, current: float, future: float, expected: float) -> None:
    assert desired_speed(one(speed), one(beta), one(current), one(future)).item() == pytest.approx(expected)


# --- s_l, Eq. 26


@pytest.mark.parametrize(
    ("remaining", "expected"), [(0, 0), (-3, 0), (7, 7), (20, 20), (60, 40), (200, 80), (300, 100)]
)
def test_the_stopping_speed_by_hand(remaining: float, expected: float) -> None:
    """Chains of 20 um/s^2 and 1 s: 20; 40 + 20; 80 + 60 + 40 + 20; ..."""
    assert stopping_speed(one(remaining)).item() == pytest.approx(expected)


def chain_um(speed: float, period_s: float) -> float:
    covered = 0.0
    while speed > 0:
        covered += speed * period_s
        speed -= LIMIT_UM_S2 * period_s
    return covered


@given(remaining=st.floats(0.01, 3000.0), period=periods)
def test_no_faster_chain_fits_into_the_remaining_distance(remaining: float, period: float) -> None:
    speed = stopping_speed(one(remaining), period_s=period).item()
    assert chain_um(speed, period) == pytest.approx(remaining)
    assert chain_um(speed + 1e-3, period) > remaining


@given(remaining=st.floats(0.01, 3000.0), period=periods)
@settings(deadline=None)
def test_the_chain_lands_on_the_end_within_the_acceleration_limit(remaining: float, period: float) -> None:
    speed = stopping_speed(one(remaining), period_s=period)
    while speed.item() > LIMIT_UM_S2 * period:
        remaining -= speed.item() * period
        slower = stopping_speed(one(remaining), period_s=period)
        assert (speed - slower).item() == pytest.approx(LIMIT_UM_S2 * period, abs=1e-4)
        speed = slower
    assert remaining - speed.item() * period == pytest.approx(0.0, abs=1e-6)


# --- the whole planner


def test_without_force_the_plan_takes_26_moves_and_ends_exactly() -> None:
    remaining, speed, beta, moves = one(2050.0), one(2.0), one(0.3), 0
    nothing = pair(0.0, 0.0)
    terminal = []
    while remaining.item() > 1e-6:
        planned = plan(nothing, nothing, nothing, remaining, speed, beta)
        assert abs((planned.speed_um_s - speed).item()) <= LIMIT_UM_S2 + 1e-6
        assert planned.speed_um_s.item() <= MAX_UM_S
        speed, beta = planned.speed_um_s, planned.beta
        remaining = remaining - speed
        terminal.append(int(planned.terminal.item()))
        moves += 1
    assert moves == 26
    assert remaining.item() == pytest.approx(0.0, abs=1e-6)
    assert terminal == sorted(terminal)  # once it is time to brake, it stays so
    assert terminal[-1] == 1


@given(
    force=st.tuples(st.floats(-200, 200), st.floats(-200, 200)),
    forecast=st.tuples(st.floats(-60, 60), st.floats(-60, 60)),
    remaining=st.floats(0.0, 2050.0),
    speed=st.floats(0.0, 100.0),
    beta=st.floats(0.0, 1.0),
)
def test_every_plan_keeps_its_promises(
    force: tuple[float, float], forecast: tuple[float, float], remaining: float, speed: float, beta: float
) -> None:
    planned = plan(pair(*force), pair(*forecast), pair(300.0, 150.0), one(remaining), one(speed), one(beta))
    planned_speed = planned.speed_um_s.item()
    assert 0 <= planned_speed <= min(MAX_UM_S, speed + LIMIT_UM_S2) + 1e-9
    assert planned_speed <= remaining + 1e-9
    assert 0 <= planned.beta.item() <= 1
    assert 0 < planned.confidence.item() <= 1 + 1e-9
    stopping = stopping_speed(one(remaining)).item()
    assert planned.terminal.item() in (0.0, 1.0)
    if not planned.terminal.item():
        assert planned_speed <= stopping
    elif stopping >= speed - LIMIT_UM_S2:
        assert planned_speed == pytest.approx(stopping)
    else:  # too fast to stop at the end: it brakes as hard as it may, unless that would pass the end at once
        assert planned_speed == pytest.approx(min(speed - LIMIT_UM_S2, remaining))


def test_more_force_never_makes_a_sure_plan_faster() -> None:
    force = torch.linspace(0, 200, 50, dtype=torch.float64)[:, None] * pair(0.6, 0.8)
    rest = [torch.full((50, 1), value, dtype=torch.float64) for value in (1500.0, 5.0, 0.3)]
    speeds = plan(force, force * 0, force * 0, *rest).speed_um_s[:, 0]
    assert torch.all(speeds.diff() <= 0)
    assert speeds[-1] < speeds[0]


def test_the_region_computes_the_plan() -> None:
    config = PlannerConfig()
    region = AxialPlanner(config, CLOCK, torch.Generator())
    inputs = {name: torch.rand(3, port.width) * 50 for name, port in config.inputs(CLOCK).items()}
    outputs, _ = region.step(inputs, region.init_state(3))
    expected = plan(*(inputs[name] for name in ("force", "forecast", "variance", "remaining", "speed", "beta")))
    assert {name: values.shape for name, values in outputs.items()} == {
        name: (3, port.width) for name, port in config.outputs(CLOCK).items()
    }
    for name, values in zip(("speed", "beta", "confidence", "terminal"), expected, strict=True):
        torch.testing.assert_close(outputs[name], values)


def test_before_anything_was_planned_speed_and_beta_are_the_papers() -> None:
    inputs = PlannerConfig().inputs(CLOCK)
    assert inputs["speed"].initial == (2.0,)
    assert inputs["beta"].initial == (0.3,)


@pytest.mark.parametrize("remaining", [0.5, 10.0, 60.0])
def test_a_planner_that_aims_past_the_end_plans_as_if_it_were_there(remaining: float) -> None:
    def speed(remaining: float, aim_past: float) -> float:
        state = (pair(3.0, 4.0), pair(0.0, 0.0), pair(300.0, 150.0), one(remaining), one(60.0), one(1.0))
        return plan(*state, aim_past_um=aim_past).speed_um_s.item()

    assert speed(remaining, 4.0) == speed(remaining + 4.0, 0.0) > speed(remaining, 0.0)


def test_a_planner_that_is_late_brakes_harder_than_it_would_but_no_harder_than_it_may() -> None:
    def speed(remaining: float) -> float:
        state = (pair(3.0, 4.0), pair(0.0, 0.0), pair(300.0, 150.0), one(remaining), one(80.0), one(1.0))
        return plan(*state, max_acceleration_um_s2=13.0, max_braking_um_s2=15.0).speed_um_s.item()

    chain = 67.0 + 54.0 + 41.0 + 28.0 + 15.0 + 2.0
    assert speed(chain) == pytest.approx(67.0)
    assert speed(chain - 5.0) == pytest.approx(67.0 - 5.0 / 6)
    assert speed(chain - 50.0) == 65.0
    assert speed(60.0) == 60.0
