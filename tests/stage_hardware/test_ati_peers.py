"""Independent programs: pynetft reads the emulated box, ATI's own library reads calibration files as we do."""

import importlib
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from stage_hardware.drivers.ati_calibration import read_calibration
from stage_hardware.drivers.pynetft_sensor import PynetftSensor
from stage_hardware.emulators.net_ft_box import NetFtBox
from stage_hardware.errors import HardwareError, LinkError
from stage_hardware.force_sensor import ForceReading

from .ati import COMPONENTS, LOAD, made_up, reading, wait_until, write_calibration


@pytest.fixture
def pynetft() -> ModuleType:
    return pytest.importorskip("pynetft")


def client_of(pynetft: ModuleType, box: NetFtBox, **more: object) -> object:
    settings = {
        "sensor_host": box.host,
        "rdt_port": box.rdt_port,
        "http_port": box.http_port,
        "receive_timeout": 0.3,
        "recovery_policy": pynetft.RecoveryPolicy.FAIL_STOP,
        **more,
    }
    return pynetft.Client(pynetft.Config(**settings), queue_size=4096)


def test_pynetft_reads_the_box(pynetft: ModuleType) -> None:
    with NetFtBox(lambda time_s: LOAD) as box, client_of(pynetft, box) as client:  # type: ignore[attr-defined]
        samples = client.samples(2.0)
        first = next(samples)
        assert first.rdt_sequence == 1
        assert (first.force_unit.value, first.torque_unit.value) == ("N", "N-mm")
        assert first.force == pytest.approx(np.array(LOAD[:3]) / 1e3)
        assert first.torque == pytest.approx(LOAD[3:])
        for _ in range(500):
            last = next(samples)
        health = client.health()
        assert health.sensor_configuration.product_name == "Emulated Net F/T"
        assert health.lost_count == health.duplicate_count == health.malformed_count == 0
        ticks = (last.ft_sequence - first.ft_sequence) / (last.rdt_sequence - first.rdt_sequence)
        assert ticks == pytest.approx(7, rel=0.01), "ft_sequence counts at 7 kHz"


def test_pynetft_counts_the_faults_that_the_box_makes(pynetft: ModuleType) -> None:
    with NetFtBox(lambda time_s: LOAD) as box, client_of(pynetft, box) as client:  # type: ignore[attr-defined]
        assert client.wait_for_first_sample(2.0)
        box.faults.drop = 20
        wait_until(lambda: client.health().lost_count == 20)
        box.faults.short = 4
        wait_until(lambda: client.health().malformed_count == 4)
        box.faults.status = 0x80010000
        wait_until(lambda: client.health().warning_count > 10)
        box.faults.status = 0
        box.faults.foreign_port = 30
        wait_until(lambda: client.health().lost_count == 20 + 4 + 30)
        assert client.health().fault_code.value == "none"


def test_pynetft_counts_across_the_wrap(pynetft: ModuleType) -> None:
    box = NetFtBox(first=2**32 - 200, loss=0.05, generator=np.random.default_rng(1))
    with box, client_of(pynetft, box) as client:  # type: ignore[attr-defined]
        wait_until(lambda: box.sent > 400)
        box.loss = 0.0
        settled = box.sent
        wait_until(lambda: box.sent > settled + 50)
        first = 2**32 - 200
        assert client.health().lost_count == len([number for number in box.lost if number != first])


@pytest.mark.parametrize(
    ("fault", "code", "count"),
    [
        ("status", "serious_status", "device_error_count"),
        ("frozen", "ft_stall", "ft_stall_count"),
        ("silent", "timeout", "timeout_count"),
        ("duplicate", "ft_stall", "duplicate_count"),
        ("swap", "ft_backward", "out_of_order_count"),
    ],
)
def test_pynetft_stops_at_serious_faults(pynetft: ModuleType, fault: str, code: str, count: str) -> None:
    """To pynetft, a record that comes twice or late is one of them."""
    with NetFtBox() as box, client_of(pynetft, box) as client:  # type: ignore[attr-defined]
        assert client.wait_for_first_sample(2.0)
        setattr(box.faults, fault, 0x80020000 if fault == "status" else 1)
        wait_until(lambda: client.health().fault_code.value == code)
        assert getattr(client.health(), count) == 1


def test_pynetft_biases_the_box(pynetft: ModuleType) -> None:
    with NetFtBox(lambda time_s: LOAD) as box, client_of(pynetft, box) as client:  # type: ignore[attr-defined]
        assert client.wait_for_first_sample(2.0)
        client.bias()
        wait_until(lambda: client.latest_sample().wrench == (0.0,) * 6)


def test_both_drivers_read_the_same(pynetft: ModuleType) -> None:
    with NetFtBox(lambda time_s: LOAD) as box:
        with reading(box) as own:
            ours = own.latest()
        with through_pynetft(box) as other:
            theirs = other.latest()
        assert theirs.valid
        assert theirs.unbiased == pytest.approx(ours.unbiased)


def test_through_pynetft_losses_status_bias_and_silence_are_as_with_our_own(pynetft: ModuleType) -> None:
    seen: list[ForceReading] = []
    with NetFtBox(lambda time_s: LOAD, loss=0.05) as box, through_pynetft(box, bias_readings=20) as sensor:
        sensor.watch(seen.append)
        sensor.bias()
        wait_until(lambda: sensor.latest().values["Fx"] == pytest.approx(0))
        assert sensor.latest().unbiased["Fx"] == pytest.approx(LOAD[0])
        wait_until(lambda: box.sent > 300)
        box.loss = 0.0
        settled = box.sent
        wait_until(lambda: sensor.latest().sequence > settled)
        assert sensor.latest().lost == len(box.lost)
        assert not {one.sequence for one in seen} & set(box.lost)
        box.faults.status = 0x80010000
        wait_until(lambda: sensor.latest().warning == "a threshold is latched")
        assert sensor.latest().valid
        box.faults.status = 0x80020000
        wait_until(lambda: not sensor.latest().valid)
        wait_until(lambda: "pynetft gave up" in (sensor.latest().fault or ""))
        assert "serious_status" in (sensor.latest().fault or "")
        box.faults.status = 0
        sensor.start()
        assert sensor.latest().valid
        box.faults.silent = True
        wait_until(lambda: not sensor.latest().valid)
    assert sensor.latest().fault == "it was stopped"


def test_a_box_that_is_not_there_is_told_through_pynetft(pynetft: ModuleType) -> None:
    sensor = PynetftSensor("wrist", "127.0.0.1", components=COMPONENTS, rdt_port=1, http_port=1, timeout_s=0.3)
    with pytest.raises((LinkError, HardwareError), match="wrist: "), sensor:
        pass


def test_without_pynetft_the_cure_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(importlib.import_module("sys").modules, "pynetft", None)
    with pytest.raises(HardwareError, match=r"pynetft is not installed; pip install 'neurorobo-stage-hardware\[ati\]'"):
        PynetftSensor("wrist", components=COMPONENTS).start()


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize(("torque", "length"), [("N-mm", "mm"), ("N-m", "m"), ("N-m", "mm")])
@pytest.mark.parametrize("is_turned", [False, True])
def test_calibrations_agree_with_atis_library(
    tmp_path: Path, seed: int, torque: str, length: str, is_turned: bool
) -> None:
    atiiaftt = pytest.importorskip("atiiaftt")
    generator = np.random.default_rng(seed)
    rows, scales = made_up(generator)
    in_lengths = 1.0 if length == "mm" else 1e-3
    transform = [*(generator.uniform(-10, 10, 3) * in_lengths), *(generator.uniform(-180, 180, 3) * is_turned)]
    path = write_calibration(
        tmp_path / "FT.cal",
        rows,
        scales,
        transform=tuple(float(round(number, 6)) for number in transform),
        torque=torque,
        length=length,
    )
    calibration = read_calibration(path)
    library = atiiaftt.FTSensor(str(path))
    units = np.array([1e3] * 3 + [1.0 if torque == "N-mm" else 1e3] * 3)
    for gauges_V, zero_V in generator.uniform(-5, 5, (20, 2, 6)):
        library.bias([*zero_V.tolist(), 0.0])
        theirs = np.array(library.convertToFt([*gauges_V.tolist(), 0.0])) * units
        ours = calibration.wrench(gauges_V) - calibration.wrench(zero_V)
        # to the precision of its single floats: four decimals of N and of N*mm, or what is left of them
        scale = np.repeat([np.abs(ours[:3]).max(), np.abs(ours[3:]).max()], 3)
        assert np.abs(theirs - ours).max() < 1.0
        assert np.all(np.abs(theirs - ours) <= np.maximum(5e-5 * np.array([1e3] * 3 + [1.0] * 3), 3e-6 * scale))


def through_pynetft(box: NetFtBox, **more: int) -> PynetftSensor:
    return PynetftSensor(
        "wrist",
        box.host,
        components=COMPONENTS,
        rdt_port=box.rdt_port,
        http_port=box.http_port,
        silence_s=0.3,
        **more,
    )
