"""Guards: what trips and what does not, and what becomes of an episode that one stops."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from neurorobo.safety.guard import Reading, SensorGuard
from neurorobo.safety.limits import Limits, SensorLimits

MS = 1_000_000


def guard(**limits: float | int) -> SensorGuard:
    return SensorGuard("force", "mN", Limits(**limits))  # type: ignore[arg-type]


@given(x=st.floats(-100, 100), y=st.floats(-100, 100))
def test_a_load_is_the_norm_and_trips_beyond_its_limit_only(x: float, y: float) -> None:
    trip = guard(stop=50.0, latch=80.0).check(Reading(0, (x, y)))
    load = math.hypot(x, y)
    assert (trip.reaction if trip else None) == ("latch" if load > 80 else "retract" if load > 50 else None)


def test_a_trip_says_what_and_how_much_and_what_to_do() -> None:
    trip = guard(stop=50.0).check(Reading(0, (30.0, 51.0)))
    assert str(trip) == "force: 59.17 mN, of 50 mN allowed; find out what is in the way"


@given(slope_mN_s=st.floats(-5000, 5000), step_ms=st.integers(1, 40))
def test_a_load_that_rises_too_fast_trips_whatever_the_rate_of_readings(slope_mN_s: float, step_ms: int) -> None:
    watch = guard(rate=1000.0, rate_window_ns=10 * MS)
    trips = [watch.check(Reading(i * step_ms * MS, (30_000 + slope_mN_s * i * step_ms * 1e-3,))) for i in range(1, 100)]
    if abs(slope_mN_s - 1000) > 1e-6:
        assert any(trips) == (slope_mN_s > 1000)


def test_noise_of_single_readings_is_no_rate() -> None:
    watch = guard(rate=1000.0, rate_window_ns=10 * MS)
    assert not any(watch.check(Reading(i * MS, (100.0 + 4.0 * (i % 2),))) for i in range(1000))  # 4000 mN/s each way


@pytest.mark.parametrize(
    ("reading", "fault"),
    [
        (Reading(2, (1.0,), sequence=5), "count on from 5 to 5"),
        (Reading(2, (1.0,), sequence=3), "count on from 5 to 3"),
        (Reading(2, (math.nan,), sequence=6), "nan"),
        (Reading(2, (1.0,), sequence=6, fault="saturated"), "saturated"),
    ],
)
def test_readings_that_cannot_be_trusted_stop_and_do_not_retract(reading: Reading, fault: str) -> None:
    watch = guard(stop=50.0)
    assert watch.check(Reading(1, (1.0,), sequence=5)) is None
    trip = watch.check(reading)
    assert trip is not None and trip.reaction == "stop" and fault in trip.fault


def test_an_old_reading_trips_once_it_is_too_old() -> None:
    watch = guard(stop=50.0, age_ns=20 * MS)
    assert watch.check_age(0) is None
    watch.check(Reading(100 * MS, (1.0,)))
    assert watch.check_age(120 * MS) is None
    trip = watch.check_age(121 * MS)
    assert trip is not None and trip.fault == "its last reading is 21.0 ms old, of 20 ms allowed"


@pytest.mark.parametrize(
    ("limits", "fault"),
    [
        ({}, "limits nothing"),
        ({"stop": "9 um"}, "stop: '9 um' is a length"),
        ({"stop": "-9 mN"}, "stop: must be greater than 0 mN"),
        ({"stop": "9 N", "latch": "8 N"}, "`latch: 8 N` is below `stop: 9 N`"),
        ({"rate": "9 N"}, "rate: '9 N' is a force"),
    ],
)
def test_limits_that_are_none_are_refused(limits: dict[str, str], fault: str) -> None:
    with pytest.raises(ValueError, match=fault):
        SensorLimits(**limits).in_unit("mN")  # type: ignore[arg-type]


def test_limits_are_converted_to_the_unit_of_the_sensor() -> None:
    limits = SensorLimits(stop="9 N", latch="14 N", rate="20 N/s").in_unit("mN")
    assert (limits.stop, limits.latch, limits.rate) == (9000.0, 14000.0, 20000.0)
