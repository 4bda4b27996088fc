"""Sequences of records and status words, without a wire."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from stage_hardware.links import rdt

WORD = 2**32


@given(first=st.sampled_from([1, WORD - 20, WORD - 1]), gaps=st.lists(st.integers(1, 40), min_size=1, max_size=60))
def test_every_loss_is_counted_across_the_wrap(first: int, gaps: list[int]) -> None:
    numbers, number = rdt.Numbers(), first
    assert numbers.take(number)
    for gap in gaps:
        number += gap
        assert numbers.take(number % WORD)
    assert numbers.last == number
    assert numbers.lost == sum(gaps) - len(gaps)
    assert numbers.duplicates == numbers.late == 0


def test_what_is_lost_before_the_first_record_counts() -> None:
    numbers = rdt.Numbers()
    assert numbers.take(4)
    assert numbers.lost == 3


@given(data=st.data())
def test_old_records_are_refused_and_told_apart(data: st.DataObject) -> None:
    sent = list(range(WORD - 10, WORD + 30))
    dropped = set(data.draw(st.lists(st.sampled_from(sent[1:-1]), unique=True, max_size=20)))
    numbers = rdt.Numbers()
    for number in sent:
        if number not in dropped:
            assert numbers.take(number % WORD)
    lost = numbers.lost
    again = data.draw(st.lists(st.sampled_from(sent), max_size=10))
    assert not any(numbers.take(number % WORD) for number in again)
    assert numbers.late == sum(number in dropped for number in again)
    assert numbers.duplicates == len(again) - numbers.late
    assert numbers.lost == lost == len(dropped)


def test_a_latched_threshold_is_a_warning_and_all_else_a_fault() -> None:
    assert rdt.meaning(0) == (None, None)
    assert rdt.meaning(0x80010000) == (None, "a threshold is latched")
    fault, warning = rdt.meaning(0x80030000)
    assert fault == "status 0x80030000: saturation, or a fault of the converter" and warning is not None
    for bit in set(range(31)) - {16}:
        assert rdt.meaning(rdt.SUMMARY | 1 << bit)[0] is not None
        assert rdt.meaning(1 << bit)[0] is not None  # not trusted though there is no summary
    assert rdt.meaning(rdt.SUMMARY)[0] is not None
    fault, _ = rdt.meaning(0x84000000 | 1 << 27, axia=True)
    assert fault is not None and "gauge out of range" in fault


@pytest.mark.parametrize(("rate_Hz", "repeats"), [(100, 1), (1000, 1), (7000, 7)])
def test_a_sensor_that_stalls_for_a_millisecond_is_found(rate_Hz: float, repeats: int) -> None:
    stream = rdt.RecordStream(rate_Hz, 1.0, 1.0)
    faults = []
    for number in range(1, repeats + 2):
        sample = stream.take(0, number, 50, 0, [0] * 6)
        assert sample is not None
        faults.append(sample.fault)
    assert faults[:-1] == [None] * repeats
    assert faults[-1] is not None and "stalled" in faults[-1]
    going_on = stream.take(0, repeats + 2, 51, 0, [0] * 6)
    assert going_on is not None and going_on.fault is None


def test_a_box_that_was_restarted_is_not_trusted_again_but_a_counter_may_wrap() -> None:
    stream = rdt.RecordStream(1000, 1.0, 1.0)
    for number, ft in enumerate((WORD - 5, 2, 9), start=1):
        sample = stream.take(0, number, ft, 0, [0] * 6)
        assert sample is not None and sample.fault is None
    for number, ft in ((4, 3), (5, 10)):
        sample = stream.take(0, number, ft, 0, [0] * 6)
        assert sample is not None and "switched off and on" in (sample.fault or "")
