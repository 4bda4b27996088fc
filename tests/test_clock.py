import pickle

import pytest
from hypothesis import given
from hypothesis import strategies as st

from neurorobo.clock import MOST_TICKS, Clock
from neurorobo.errors import ConfigError, Fault


def faults_of(**values: object) -> dict[tuple[str | int, ...], str]:
    with pytest.raises(ConfigError) as caught:
        Clock.from_config(values)
    return {fault.path: fault.message for fault in caught.value.faults}


def test_periods_count_in_ticks_of_their_common_measure() -> None:
    clock = Clock.from_config({"control": "1 s", "radial": "200 ms", "slow": "2 s", "spike_step": "1 ms", "window": 50})
    assert clock.tick_ns == 200_000_000
    assert {name: clock.ticks(name) for name in clock.periods_ns} == {"control": 5, "radial": 1, "slow": 10}
    assert clock.seconds("radial") == 0.2
    assert clock.window_ns == 50_000_000


def test_two_periods_that_share_no_multiple_but_the_longest_have_a_finer_tick() -> None:
    clock = Clock.from_config({"control": "1 s", "a": "250 ms", "b": "200 ms"})
    assert clock.tick_ns == 50_000_000
    assert (clock.ticks("a"), clock.ticks("b")) == (5, 4)


def test_the_spike_window_has_a_default_and_the_whole_is_written_out() -> None:
    clock = Clock.from_config({"control": "1 s"})
    assert clock.to_config() == {"control": "1 s", "spike_step": "1 ms", "window": 50}


@given(
    st.integers(1, 10**6),
    st.lists(st.sampled_from([1, 2, 4, 5, 8, 10]), max_size=3),
    st.integers(1, 10**6),
    st.integers(1, 1000),
)
def test_a_clock_reads_back_from_what_it_writes(period: int, parts: list[int], spike_step_ns: int, window: int) -> None:
    periods_ns = {"control": period * 40, **{f"p{n}": period * 40 // n for n in parts}}
    clock = Clock(periods_ns, spike_step_ns, window)
    assert Clock.from_config(clock.to_config()) == clock
    assert hash(Clock.from_config(clock.to_config())) == hash(clock)
    for name, period_ns in periods_ns.items():
        assert clock.ticks(name) * clock.tick_ns == period_ns


def test_a_period_that_does_not_divide_the_longest_is_refused_with_the_nearest_that_do() -> None:
    assert faults_of(control="1 s", radial="300 ms", fine="7 ms") == {
        ("radial",): "300 ms does not divide control: 1 s; choose e.g. 250 ms or 200 ms",
        ("fine",): "7 ms does not divide control: 1 s; choose e.g. 8 ms or 5 ms",
    }


@given(st.integers(1, 10**10), st.integers(1, 10**10))
def test_the_periods_that_a_message_proposes_are_accepted(long_ns: int, period_ns: int) -> None:
    try:
        Clock({"control": long_ns, "fast": period_ns}, 1_000_000, 50)
    except ConfigError as error:
        proposals = error.faults[0].message.partition("choose e.g. ")[2]
        for proposal in proposals.split(" or ") if proposals else []:
            longest = max(long_ns, period_ns)
            Clock.from_config({"control": f"{longest} ns", "fast": proposal})


def test_a_tick_too_fine_for_the_longest_period_is_refused() -> None:
    assert Clock.from_config({"control": "1 s", "fast": f"{1_000_000 // MOST_TICKS} us"}).ticks("control") == MOST_TICKS
    [message] = faults_of(control="1 s", fast="50 us").values()
    assert "a tick of 50 us, of which control: 1 s holds 20000, more than 10000" in message


def test_all_faults_are_reported_at_once() -> None:
    assert faults_of(control=5, radial="1 um", window=2.5) == {
        ("window",): "must be a whole number of spike steps, e.g. 50 (got 2.5)",
        ("control",): "must be a time such as '200 ms' (got 5)",
        ("radial",): "'1 um' is a length, wanted a time such as '1 ms'",
    }
    assert faults_of(control="1 s", radial="0 s", spike_step="0 ms", window=0) == {
        ("radial",): "must be longer than zero (got '0 s')",
        ("spike_step",): "must be longer than zero (got '0 s')",
        ("window",): "must be at least 1 spike step (got 0)",
    }


def test_the_control_period_is_required() -> None:
    assert faults_of(radial="1 s") == {
        ("control",): "is missing; every brain has a control period, e.g. 'control: 1 s'"
    }


def test_faults_can_be_moved_down_a_document() -> None:
    error = ConfigError([Fault(("radial",), "is wrong")]).under("time")
    assert error.faults == (Fault(("time", "radial"), "is wrong"),)
    assert str(error) == "time.radial: is wrong"


def test_a_config_error_is_the_same_in_another_process() -> None:
    error = ConfigError([Fault(("a",), "is wrong"), Fault(("b",), "too")], ["x.yaml:1:1: a: is wrong", "b: too"])
    copy = pickle.loads(pickle.dumps(error))
    assert (copy.faults, str(copy)) == (error.faults, str(error))


def test_a_period_that_is_not_there_is_named_where_it_is_asked_for() -> None:
    clock = Clock.from_config({"control": "1 s", "radial": "200 ms"})
    for lookup in (clock.ticks, clock.seconds):
        with pytest.raises(ConfigError) as caught:
            lookup("radia")
        assert caught.value.faults == (
            Fault(("period",), "there is no period `radia` under `time`; did you mean `radial`?"),
        )
