import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from precision_interaction import table_one
from precision_interaction.regions.approach import Approach, approach
from precision_interaction.regions.approach_config import ApproachConfig
from precision_interaction.teachers import contact_expectation
from precision_interaction.teachers.compensators import (
    PredictiveCompensator,
    ProfileCompensator,
    predictive,
    profile,
    trust,
)
from precision_interaction.teachers.compensators_config import CompensatorConfig, PredictiveConfig, ProfileConfig
from precision_interaction.teachers.contact_expectation import ContactLaw
from precision_interaction.teachers.contact_expectation_config import ContactLawConfig
from torch import Tensor

from neurorobo.clock import Clock
from neurorobo.errors import ConfigError

CLOCK = Clock({"control": 10**9, "radial": 2 * 10**8}, spike_step_ns=10**6, window=50)
LIMIT_UM_S2 = table_one.MAX_ACCELERATION_UM_S2
forces = st.floats(-400.0, 400.0)
velocities = st.floats(-20.0, 20.0)
periods = st.sampled_from([0.05, 0.2, 1.0])


def pair(x: float, y: float = 0.0) -> Tensor:
    return torch.tensor([[x, y]], dtype=torch.float64)


ZERO = pair(0.0)


# --- gamma_r, Eq. 16


def test_a_forecast_is_trusted_fully_up_to_sigma_0_and_ever_less_beyond() -> None:
    deviations = torch.tensor([0.0, 1.0, 99.0, 100.0, 101.0, 150.0, 200.0, 1000.0, 1e6], dtype=torch.float64)
    trusted = trust(deviations**2, sigma_0_mN=100.0)
    assert torch.all(trusted[:4] == 1)
    assert torch.all(trusted[4:].diff() < 0)
    assert torch.all(trusted[4:] < 1)
    assert torch.all(trusted > 0)


def test_trust_by_hand() -> None:
    """At twice sigma_0: P(|z| < 1/2) / P(|z| < 1), from the table of the normal distribution."""
    assert trust(pair(200.0**2), sigma_0_mN=100.0)[0, 0].item() == pytest.approx(0.38292 / 0.68269, rel=1e-4)


# --- the profile, Eq. 14-19


def test_the_profile_from_rest_by_hand() -> None:
    """p_1 = 0: the path of 80 mN over 80 mN/um starts 1 um away and has exp(-1) um left after 1 s."""
    got = profile(pair(80.0), ZERO, ZERO, ZERO, period_s=1.0)
    assert got.move_um[0, 0].item() == pytest.approx(1 - math.exp(-1))
    assert got.residual_mN[0, 0].item() == pytest.approx(80 * math.exp(-1))
    assert got.velocity_um_s[0, 0].item() == pytest.approx(2 * math.exp(-1))
    assert got.move_um[0, 1] == got.velocity_um_s[0, 1] == 0


def test_the_profile_in_motion_by_hand() -> None:
    """f = 60, mu = 20, v = 1: p_1 = -M v / (2 f~) = -1/2, so the path ends at -exp(-2) um."""
    got = profile(pair(60.0), pair(1.0), pair(20.0), ZERO, period_s=1.0)
    end = -math.exp(-2)
    assert got.move_um[0, 0].item() == pytest.approx(1 + end)
    assert got.residual_mN[0, 0].item() == pytest.approx(60 - 80 * (1 + end))
    assert got.velocity_um_s[0, 0].item() == pytest.approx(-2 * 1.5 * end)


@given(force=forces.filter(lambda f: abs(f) > 10), velocity=st.floats(-0.2, 0.2))
def test_the_path_begins_with_the_velocity_it_was_given(force: float, velocity: float) -> None:
    """Eq. 15, second row: over a short period the mean velocity is the previous one, while p_1 is not clipped."""
    start_um = -force / 80
    if abs(velocity / (2 * start_um)) < 1:
        short_s = 1e-6
        got = profile(pair(force), pair(velocity), ZERO, ZERO, period_s=short_s, max_acceleration_um_s2=1e9)
        assert got.move_um[0, 0].item() / short_s == pytest.approx(velocity, abs=1e-4)


@given(force=forces, velocity=velocities, mean=forces, period=periods)
def test_the_profile_stays_finite_and_no_steeper_than_a_clipped_path(
    force: float, velocity: float, mean: float, period: float
) -> None:
    got = profile(pair(force), pair(velocity), pair(mean), ZERO, period_s=period, max_acceleration_um_s2=1e9)
    most = abs(force + mean) / 80 * max(1.0, abs(math.exp(2 * period - period**2) - 1))
    assert got.move_um[0, 0].abs().item() <= most + 1e-9


def test_the_shift_of_the_path_is_clipped() -> None:
    clipped = profile(pair(1.0), pair(100.0), ZERO, ZERO, period_s=1.0)
    at_limit = profile(pair(1.0), pair(2.0 / 80.0), ZERO, ZERO, period_s=1.0)
    torch.testing.assert_close(clipped.move_um, at_limit.move_um)
    wider = profile(pair(1.0), pair(100.0), ZERO, ZERO, period_s=1.0, max_p1_s=2.0)
    assert not torch.allclose(wider.move_um, clipped.move_um)


def test_a_path_that_is_too_steep_is_scaled_to_the_limit() -> None:
    """From rest the path starts with the acceleration 2 f / M (Eq. 17); Eq. 18 limits the norm of both axes."""
    free = profile(pair(2400.0, 3200.0), ZERO, ZERO, ZERO, period_s=0.2, max_acceleration_um_s2=1e9)
    limited = profile(pair(2400.0, 3200.0), ZERO, ZERO, ZERO, period_s=0.2, max_acceleration_um_s2=20.0)
    torch.testing.assert_close(limited.move_um, free.move_um * 20 / 100)
    within = profile(pair(240.0, 320.0), ZERO, ZERO, ZERO, period_s=0.2, max_acceleration_um_s2=20.0)
    torch.testing.assert_close(within.move_um, free.move_um / 10)


# --- the predictive compensator


def test_the_expected_force_is_zeroed_where_the_limit_allows_it() -> None:
    got = predictive(pair(60.0, -30.0), ZERO, pair(20.0, 107.0), pair(117.0, 53.0), period_s=1.0)
    torch.testing.assert_close(got.move_um, pair(1.0, 0.9625))
    torch.testing.assert_close(got.residual_mN, pair(-20.0, -107.0))


def test_an_uncertain_mean_counts_less() -> None:
    got = predictive(ZERO, ZERO, pair(80.0), pair(200.0**2), period_s=1.0)
    assert got.move_um[0, 0].item() == pytest.approx(0.5609, abs=1e-4)


@given(
    force=st.tuples(forces, forces),
    velocity=st.tuples(velocities, velocities),
    mean=st.tuples(forces, forces),
    period=periods,
)
def test_predictive_never_exceeds_the_acceleration(
    force: tuple[float, float], velocity: tuple[float, float], mean: tuple[float, float], period: float
) -> None:
    got = predictive(pair(*force), pair(*velocity), pair(*mean), ZERO, period_s=period)
    change_um_s = (got.velocity_um_s - pair(*velocity)).norm().item()
    assert change_um_s <= LIMIT_UM_S2 * period * (1 + 1e-9)
    torch.testing.assert_close(got.move_um, got.velocity_um_s * period)


@given(force=forces, period=periods)
@settings(max_examples=50, deadline=None)
def test_predictive_brakes_in_time(force: float, period: float) -> None:
    """From rest, without contact, the force goes to zero and never changes its sign."""
    remaining, velocity = pair(force), ZERO
    for _ in range(int(20 / period)):
        got = predictive(remaining, velocity, ZERO, ZERO, period_s=period)
        remaining, velocity = got.residual_mN, got.velocity_um_s
        assert remaining[0, 0].item() * force >= -1e-9 * force**2
    assert abs(remaining[0, 0].item()) < 1e-6


@given(force=forces, velocity=velocities, mean=forces, period=periods)
def test_the_residual_is_what_the_move_leaves(force: float, velocity: float, mean: float, period: float) -> None:
    """Eq. 19 as read: f - M m_r, without the contact of the period."""
    for compensator in (profile, predictive):
        got = compensator(pair(force), pair(velocity), pair(mean), ZERO, period_s=period)
        torch.testing.assert_close(got.residual_mN, pair(force) - 80 * got.move_um)


# --- the contact law, Eq. 8 and 35


def test_n_uses_look_n_periods_ahead() -> None:
    speed = torch.tensor([[30.0], [100.0], [0.0]])
    one = contact_expectation.one_period(speed, period_s=0.2)
    torch.testing.assert_close(one.mean_mN[0], torch.tensor([0.618, 1.072]) * 6)
    torch.testing.assert_close(one.variance_mN2[0], torch.tensor([1.172, 0.535]) * 6)
    mean, variance = torch.zeros(3, 2), torch.zeros(3, 2)
    for n in (1, 2, 3):
        mean, variance = contact_expectation.expect(speed, mean, variance, period_s=0.2)
        torch.testing.assert_close(mean, n * one.mean_mN)
        torch.testing.assert_close(variance, n * one.variance_mN2)


def test_the_printed_eq_9_doubles() -> None:
    speed = torch.tensor([[30.0], [0.0]])
    one = contact_expectation.one_period(speed, period_s=1.0)
    mean, variance = torch.zeros(2, 2), torch.zeros(2, 2)
    for factor in (1, 2, 4):
        mean, variance = contact_expectation.expect(speed, mean, variance, period_s=1.0, doubling=True)
        torch.testing.assert_close(mean, factor * one.mean_mN)
        torch.testing.assert_close(variance, factor * one.variance_mN2)


def test_the_measured_law_gives_the_published_points_and_spreads_its_intercept_over_an_axial_move() -> None:
    speed = torch.tensor([[10.0], [50.0], [0.0]], dtype=torch.float64)
    mean, variance = contact_expectation.one_period(speed, period_s=1.0, law="measured")
    torch.testing.assert_close(mean, torch.tensor([[12.7, 20.3], [29.6, 51.7], [0, 0]], dtype=torch.float64))
    torch.testing.assert_close(variance, torch.tensor([[23.2, 7.0], [56.3, 26.4], [0, 0]], dtype=torch.float64))
    fifth = contact_expectation.one_period(speed, period_s=0.2, law="measured")
    torch.testing.assert_close(5 * fifth.mean_mN, mean)
    torch.testing.assert_close(5 * fifth.variance_mN2, variance)


@pytest.mark.parametrize(
    ("travel_um", "speed_um_s", "expected"),
    [(0.0, 49.0, 0.0), (0.0, 50.0, 0.0), (0.0, 51.0, 51.0), (40.0, 5.0, 0.0), (40.0, 20.0, 20.0), (500.0, 2.0, 2.0)],
)
def test_contact_is_expected_once_the_period_ends_beyond_the_gap(
    travel_um: float, speed_um_s: float, expected: float
) -> None:
    got = approach(
        torch.tensor([[speed_um_s]]), torch.tensor([[2050 - travel_um]]), length_um=2050, gap_um=50, period_s=1.0
    )
    assert got.item() == expected


# --- as regions


@pytest.mark.parametrize(
    ("region", "function"),
    [
        (ProfileCompensator(ProfileConfig(), CLOCK, torch.Generator()), profile),
        (PredictiveCompensator(PredictiveConfig(), CLOCK, torch.Generator()), predictive),
    ],
)
def test_a_compensator_region_computes_its_function_at_its_period(region, function) -> None:  # type: ignore[no-untyped-def]
    inputs = {name: 50 * torch.rand(4, 2) for name in region.config.inputs(CLOCK)}
    outputs, state = region.step(inputs, region.init_state(4))
    expected = function(inputs["force"], inputs["velocity"], inputs["mean"], inputs["variance"], period_s=0.2)
    assert state == {}
    assert set(outputs) == set(region.config.outputs(CLOCK))
    torch.testing.assert_close(outputs["move"], expected.move_um)
    torch.testing.assert_close(outputs["residual"], expected.residual_mN)
    torch.testing.assert_close(outputs["velocity"], expected.velocity_um_s)


def test_the_contact_regions_compute_their_functions() -> None:
    law = ContactLaw(ContactLawConfig(law="measured"), CLOCK, torch.Generator())
    speed, feedback = torch.tensor([[40.0]]), torch.ones(1, 2)
    outputs, _ = law.step({"speed": speed, "mean_feedback": feedback, "variance_feedback": 2 * feedback}, {})
    expected = contact_expectation.expect(speed, feedback, 2 * feedback, period_s=0.2, law="measured")
    torch.testing.assert_close((outputs["mean"], outputs["variance"]), tuple(expected))
    gap = Approach(ApproachConfig(), CLOCK, torch.Generator())
    assert gap.step({"speed": speed, "remaining": torch.tensor([[2009.0]])}, {})[0]["speed"].item() == 0
    assert gap.step({"speed": speed, "remaining": torch.tensor([[2007.0]])}, {})[0]["speed"].item() == 40


@pytest.mark.parametrize("config", [ProfileConfig(period="fast"), ContactLawConfig(axial_period="fast")])
def test_an_unknown_period_is_refused_by_name(config: CompensatorConfig | ContactLawConfig) -> None:
    with pytest.raises(ConfigError, match=r"period: there is no period `fast`"):
        config.inputs(CLOCK)
