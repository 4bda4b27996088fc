"""The driver of the Net F/T against the emulated box: readings, faults of the stream, and of the page."""

import math
import socket
import sys
import time
from itertools import pairwise

import numpy as np
import pytest
from stage_hardware.drivers.ati_net_ft import AtiNetFt
from stage_hardware.emulators.net_ft_box import NetFtBox
from stage_hardware.errors import HardwareError, LinkError, RefusedError, ReplyError, ReplyTimeoutError
from stage_hardware.force_sensor import WRENCH, ForceReading
from stage_hardware.links import rdt

from .ati import COMPONENTS, LOAD, reading, wait_until


def loaded(**more: float) -> NetFtBox:
    return NetFtBox(lambda time_s: LOAD, **more)  # type: ignore[arg-type]


@pytest.mark.parametrize("rate_Hz", [100, 1000, 4000])
def test_it_reads_the_wrench_at_the_rate_of_the_box(rate_Hz: float) -> None:
    with loaded(rate_Hz=rate_Hz) as box, reading(box) as sensor:
        first = sensor.latest()
        assert first.valid and list(first.values) == list(WRENCH)
        assert list(first.unbiased.values()) == pytest.approx(LOAD, abs=1e-3)
        began, since = time.monotonic(), box.sent
        wait_until(lambda: sensor.latest().sequence >= first.sequence + rate_Hz / 4, within_s=20)
        assert box.sent - since == pytest.approx(rate_Hz * (time.monotonic() - began), rel=0.2, abs=20)
        later = sensor.latest()
        assert later.time_ns > first.time_ns and later.age_ns(time.monotonic_ns()) < 1e9
        assert sensor.counts.lost == 0


def test_readings_follow_the_load_in_its_units() -> None:
    load = [0.0] * 6
    with NetFtBox(lambda time_s: load) as box, reading(box) as sensor:
        load[:] = LOAD
        wait_until(lambda: sensor.latest().values["Fx"] == pytest.approx(LOAD[0]))
    with NetFtBox(lambda time_s: (1.0,) * 6) as box:
        # 1e6 counts per N and N*mm are sent: a page that says pounds makes pounds of them
        box.page |= {"scfgfu": "lbf", "scfgtu": "lbf-in", "cfgmr": ""}
        with reading(box) as sensor:
            values = sensor.latest().values
            assert values["Fx"] == pytest.approx(4.4482216)
            assert values["Tz"] == pytest.approx(112.98483)


def test_a_bias_is_the_hosts_and_the_unbiased_values_stay() -> None:
    load = np.array(LOAD)
    with NetFtBox(lambda time_s: load) as box, reading(box, bias_readings=20) as sensor:
        sensor.bias()
        wait_until(lambda: abs(sensor.latest().values["Fx"]) < 1e-6)
        assert list(sensor.latest().unbiased.values()) == pytest.approx(LOAD)
        load += 5
        wait_until(lambda: sensor.latest().values["Tx"] == pytest.approx(5))
        assert sensor.latest().unbiased["Tx"] == pytest.approx(LOAD[3] + 5)
        sensor.start()
        assert sensor.latest().values["Tx"] == pytest.approx(5), "a bias outlasts a new start"


def test_no_bias_is_taken_of_faulty_readings_or_none() -> None:
    with loaded() as box, reading(box, bias_readings=10) as sensor:
        box.faults.status = rdt.SUMMARY | rdt.SATURATED
        with pytest.raises(HardwareError, match="wrist: no bias: status 0x80020000: saturation"):
            sensor.bias()
        box.faults.silent = True
        with pytest.raises(ReplyTimeoutError, match="only 0 of 10 readings came"):
            time.sleep(0.05)
            sensor.bias()
    with pytest.raises(HardwareError, match="no bias: it was stopped; start it first"):
        sensor.bias()


@pytest.mark.parametrize("first", [1, 2**32 - 100])
def test_every_loss_is_counted_and_none_is_made_up(first: int) -> None:
    seen: list[ForceReading] = []
    with NetFtBox(lambda time_s: (time_s,) * 6, first=first, loss=0.05, generator=np.random.default_rng(5)) as box:
        with reading(box) as sensor:
            sensor.watch(seen.append)
            wait_until(lambda: box.sent >= 400)
            box.loss = 0.0
            settled = box.sent
            wait_until(lambda: sensor.latest().sequence > first + settled)
            # of a first record that is lost a stream that begins elsewhere than at 1 does not know
            lost = [number for number in box.lost if number != first or first == 1]
            assert lost and sensor.counts.lost == sensor.latest().lost == len(lost)
        numbers = [one.sequence % 2**32 for one in seen]
        assert not set(numbers) & set(box.lost)
        assert len(set(numbers)) == len(numbers)
        assert all(b.sequence - a.sequence - 1 == b.lost - a.lost for a, b in pairwise(seen))


def test_records_that_come_twice_late_short_or_from_elsewhere_are_refused() -> None:
    with loaded() as box, reading(box) as sensor:
        for fault, count in (("duplicate", "duplicates"), ("swap", "late"), ("short", "malformed")):
            setattr(box.faults, fault, 5)
            wait_until(lambda count=count: getattr(sensor.counts, count) == 5)  # type: ignore[misc]
        box.faults.foreign_port = 5
        wait_until(lambda: sensor.counts.foreign == 5)
        if sys.platform == "linux":  # where all of 127/8 is this machine
            box.faults.foreign_address = 5
            wait_until(lambda: sensor.counts.foreign == 10)
        foreign = sensor.counts.foreign
        wait_until(lambda: sensor.counts.lost == 5 + 5 + foreign)  # late, short, foreign: not used
        assert sensor.latest().valid


def test_a_stream_of_refused_records_is_silence_that_says_why() -> None:
    with loaded() as box, reading(box) as sensor:
        box.faults.foreign_port = 10**9
        wait_until(lambda: not sensor.latest().valid)
        assert "from another address or port" in (sensor.latest().fault or "")


def test_status_bits_are_faults_or_warnings() -> None:
    with loaded() as box, reading(box) as sensor:
        box.faults.status = 0x80010000
        wait_until(lambda: sensor.latest().warning == "a threshold is latched")
        assert sensor.latest().valid
        box.faults.status = 0x80020000
        wait_until(lambda: not sensor.latest().valid)
        assert sensor.latest().fault == "status 0x80020000: saturation, or a fault of the converter"
        box.faults.status = 0
        wait_until(lambda: sensor.latest().valid)


def test_silence_is_a_fault_and_the_reading_keeps_its_age() -> None:
    with loaded() as box, reading(box, silence_s=0.1) as sensor:
        box.faults.silent = True
        wait_until(lambda: not sensor.latest().valid)
        reading_ = sensor.latest()
        assert "no reading for 0." in (reading_.fault or "")
        assert reading_.age_ns(time.monotonic_ns()) >= 0.1e9
        lost = sensor.counts.lost
        box.faults.silent = False
        wait_until(lambda: sensor.latest().valid)
        assert sensor.counts.lost >= lost + 80, "what the silence has cost is counted"


def test_a_sensor_that_stalls_and_a_box_that_was_restarted_are_found() -> None:
    with loaded() as box, reading(box) as sensor:
        box.faults.frozen = True
        wait_until(lambda: "has stalled" in (sensor.latest().fault or ""))
        box.faults.frozen = False
        wait_until(lambda: sensor.latest().valid)
        box.power_cycle()
        wait_until(lambda: "no reading for" in (sensor.latest().fault or ""))
        sensor.start()
        assert sensor.latest().valid


def test_another_client_gets_the_stream_and_keeps_it() -> None:
    with loaded() as box, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        with reading(box) as sensor:
            other.settimeout(2)
            other.sendto(rdt.REQUEST.pack(rdt.HEADER, rdt.START, 0), (box.host, box.rdt_port))
            other.recv(100)
            wait_until(lambda: "another client has the stream" in (sensor.latest().fault or ""))
        assert box.stopped == 0, "a stream that is another's is not stopped"
        other.recv(100)
        with reading(box) as sensor:
            assert sensor.latest().valid
        wait_until(lambda: box.stopped == 1)


def test_a_request_that_is_lost_is_repeated() -> None:
    with loaded() as box:
        box.faults.deaf = 3
        with reading(box) as sensor:
            assert sensor.latest().valid
        box.faults.deaf = 10**9
        silent = pytest.raises(ReplyTimeoutError, match=r"wrist: no reading within 0\.5 s .*; see to power, network")
        with silent, reading(box, timeout_s=0.5):
            pass


def test_before_and_after_there_is_no_valid_reading() -> None:
    with loaded() as box:
        sensor = AtiNetFt("wrist", box.host, components=COMPONENTS, rdt_port=box.rdt_port, http_port=box.http_port)
        sensor.stop()
        assert sensor.latest().fault == "it was not started" and math.isnan(sensor.latest().values["Fx"])
        sensor.start()
        assert sensor.latest().valid
        sensor.stop()
        sensor.stop()
        assert sensor.latest().fault == "it was stopped"


def test_a_watcher_that_fails_makes_readings_invalid() -> None:
    def fail(reading: ForceReading) -> None:
        raise RuntimeError("no limit is set")

    with loaded() as box, reading(box) as sensor:
        sensor.watch(fail)
        wait_until(lambda: sensor.latest().fault == "no limit is set")


def test_a_page_that_does_not_fit_is_refused_before_anything_is_sent() -> None:
    wrong: list[tuple[dict[str, str], type[HardwareError], str]] = [
        ({"comrdtrate": "500"}, HardwareError, "sends 500 readings a second, not 1000; set the rate"),
        ({"cfgmr": "36;36;36;500;500;500"}, HardwareError, "set up for Fx up to 36000 mN, not 18000; select"),
        ({"comrdte": "Disabled"}, RefusedError, "RDT is disabled; enable it"),
        ({"cfgcpf": "0"}, ReplyError, "cannot be read .0 and 1e.06 counts per unit"),
        ({"cfgcpf": "many"}, ReplyError, "cannot be read"),
        ({"scfgfu": "stone"}, ReplyError, "'stone' is no unit of force"),
        ({"scfgtu": "stone"}, ReplyError, "'stone' is no unit of torque"),
        ({"prodname": "<"}, ReplyError, "is no XML"),
    ]
    for elements, kind, message in wrong:
        with loaded() as box:
            box.page |= elements
            with pytest.raises(kind, match=message), reading(box):
                pass
            assert box.sent == 0
    with loaded() as box:
        del box.page["cfgcpt"]
        with pytest.raises(ReplyError, match="has no cfgcpt"), reading(box):
            pass


def test_a_bias_on_the_box_is_told() -> None:
    with loaded() as box:
        box.page["setbias"] = "0;0;12;0;0;0"
        with reading(box) as sensor:
            assert sensor.latest().warning == "the box subtracts a bias of its own"
            box.faults.status = 0x80010000
            wait_until(lambda: "latched" in (sensor.latest().warning or ""))


def test_a_page_that_does_not_come_says_so() -> None:
    with loaded() as box:
        box.faults.slow_page_s = 5
        slow = pytest.raises(LinkError, match=r"wrist: http://127\.0\.0\.1:\d+/netftapi2\.xml cannot be read")
        with slow, reading(box, timeout_s=0.2):
            pass
    with pytest.raises(LinkError, match="see to power, network and address"), reading(box_that_is_closed()):
        pass


def box_that_is_closed() -> NetFtBox:
    box = loaded().start()
    box.close()

    class Closed(NetFtBox):
        rdt_port = http_port = 1  # nobody listens there

    return Closed()


def test_the_box_biases_itself_until_power_is_lost() -> None:
    with loaded() as box, reading(box) as sensor:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
            other.sendto(rdt.REQUEST.pack(rdt.HEADER, rdt.BIAS, 0), (box.host, box.rdt_port))
            wait_until(lambda: sensor.latest().unbiased["Fx"] == 0)
        box.power_cycle()
        sensor.start()
        assert sensor.latest().unbiased["Fx"] == pytest.approx(LOAD[0])


def test_the_box_sends_as_many_records_as_it_was_asked_for() -> None:
    with loaded() as box, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        client.settimeout(1)
        client.sendto(rdt.REQUEST.pack(rdt.HEADER, rdt.START, 5), (box.host, box.rdt_port))
        numbers = [rdt.RECORD.unpack(client.recv(100))[0] for _ in range(5)]
        assert numbers == [1, 2, 3, 4, 5]
        with pytest.raises(TimeoutError):
            client.recv(100)
