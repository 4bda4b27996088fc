"""The contract of a force sensor, on the one without a wire."""

import time

import pytest
from stage_hardware.emulators.mock_force_sensor import MockForceSensor
from stage_hardware.errors import HardwareError, LinkError
from stage_hardware.force_sensor import Component, ForceReading

from .ati import wait_until

ONE = {"Fz": Component("mN", 1000.0, 1.0)}


def test_it_reads_biases_and_keeps_what_is_not_biased() -> None:
    load = [250.0]
    with MockForceSensor("tip", ONE, lambda time_s: load, bias_readings=20) as tip:
        assert tip.latest().values == tip.latest().unbiased == {"Fz": 250.0}
        tip.bias()
        load[0] = 300.0
        wait_until(lambda: tip.latest().values == {"Fz": 50.0})
        assert tip.latest().unbiased == {"Fz": 300.0}


def test_a_bias_is_the_mean_of_as_many_readings_as_it_says() -> None:
    count = iter(range(10**6))
    with MockForceSensor("tip", ONE, lambda time_s: (float(next(count) % 2),), bias_readings=50) as tip:
        tip.bias()
        wait_until(lambda: tip.latest().valid)
        reading = tip.latest()
        assert reading.unbiased["Fz"] - reading.values["Fz"] == 0.5


def test_its_faults_show() -> None:
    with MockForceSensor("tip", ONE, lambda time_s: (1.0,)) as tip:
        tip.fault = "out of order"
        wait_until(lambda: tip.latest().fault == "out of order")
        tip.fault, tip.warning = None, "warm"
        wait_until(lambda: tip.latest().valid and tip.latest().warning == "warm")
        tip.lose = 7
        wait_until(lambda: tip.latest().lost == 7)
        tip.silent = True
        wait_until(lambda: "no reading for" in (tip.latest().fault or ""))
        assert tip.latest().age_ns(time.monotonic_ns()) > 0.1e9
    tip.absent = True
    with pytest.raises(LinkError, match="tip: it is not there"):
        tip.start()
    tip.absent = False
    with pytest.raises(HardwareError, match=r"no reading within 0\.5 s"):
        tip.start()  # it is silent still


def test_a_watcher_sees_each_reading_in_order() -> None:
    seen: list[ForceReading] = []
    with MockForceSensor("tip", ONE, lambda time_s: (1.0,), rate_Hz=500) as tip:
        tip.watch(seen.append)
        tip.fault = "out of order"
        wait_until(lambda: len(seen) > 100)
    numbers = [reading.sequence for reading in seen]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    assert any(not reading.valid for reading in seen)
