"""Calibration files, and the sensor whose gauges a card reads."""

import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from stage_hardware import force_units
from stage_hardware.drivers.ati_calibration import AtiCalibration, read_calibration
from stage_hardware.drivers.ati_daq import AtiDaq
from stage_hardware.emulators.ati_gauges import AtiGauges
from stage_hardware.errors import HardwareError
from stage_hardware.force_sensor import WRENCH

from .ati import LOAD, made_up, wait_until, write_calibration

IDENTITY = np.eye(6), np.ones(6)


@pytest.fixture
def calibration(tmp_path: Path) -> AtiCalibration:
    rows, scales = made_up(np.random.default_rng(7))
    return read_calibration(write_calibration(tmp_path / "FT.cal", rows, scales, transform=(0, 0, 4.7, 0, 0, 0)))


def sensor(calibration: AtiCalibration, gauges: AtiGauges, rate_Hz: float = 500.0, **more: float) -> AtiDaq:
    return AtiDaq(
        "wrist",
        calibration,
        gauges,
        rate_Hz=rate_Hz,
        resolution_mN=4,
        resolution_mNm=0.05,
        silence_s=0.3,
        **more,  # type: ignore[arg-type]
    )


def test_rows_are_divided_by_their_scales_and_come_in_mN_and_mNm(tmp_path: Path) -> None:
    read = read_calibration(write_calibration(tmp_path / "a.cal", np.eye(6), np.array([1, 2, 4, 1, 2, 4.0])))
    assert read.matrix == pytest.approx(np.diag([1000, 500, 250, 1, 0.5, 0.25]))
    assert read.largest == pytest.approx((18e3,) * 3 + (250,) * 3)
    assert (read.serial, read.part_number, read.full_scale_V) == ("FT00000", "SI-18-0.25", 10)
    newtons = write_calibration(tmp_path / "b.cal", *IDENTITY, force="lb", torque="in-lb", length="in")
    assert read_calibration(newtons).matrix[0, 0] == pytest.approx(4448.2216)
    assert read_calibration(newtons).matrix[5, 5] == pytest.approx(112.98483)


@given(
    shift_mm=st.tuples(*[st.floats(-50, 50)] * 3),
    angles_deg=st.tuples(*[st.floats(-180, 180)] * 3),
    force=st.tuples(*[st.floats(-5, 5)] * 3),
    torque=st.tuples(*[st.floats(-100, 100)] * 3),
)
def test_another_origin_changes_torques_by_the_lever_and_axes_by_a_rotation(
    tmp_path_factory: pytest.TempPathFactory,
    shift_mm: tuple[float, float, float],
    angles_deg: tuple[float, float, float],
    force: tuple[float, float, float],
    torque: tuple[float, float, float],
) -> None:
    path = write_calibration(tmp_path_factory.mktemp("cal") / "a.cal", *IDENTITY, transform=shift_mm + angles_deg)
    found = read_calibration(path).wrench([*force, *torque])
    about_new_origin = np.array(torque) - np.cross(shift_mm, force)  # N*mm, which is mN*m
    assert np.linalg.norm(found[:3]) == pytest.approx(1e3 * np.linalg.norm(force), abs=1e-6)
    assert np.linalg.norm(found[3:]) == pytest.approx(np.linalg.norm(about_new_origin), abs=1e-6)
    # force and torque turn together, and nothing is mirrored
    assert found[:3] @ found[3:] == pytest.approx(1e3 * np.dot(force, about_new_origin), abs=1e-3)


@pytest.mark.parametrize(
    ("angles_deg", "turned"),
    [
        ((90, 0, 0), (1, 3, -2)),  # z lies where y was before
        ((0, 90, 0), (-3, 2, 1)),
        ((0, 0, 90), (2, -1, 3)),
        ((90, 0, 90), (3, -1, -2)),  # about x first
    ],
)
def test_axes_turn_about_x_then_y_then_z(
    tmp_path: Path, angles_deg: tuple[float, float, float], turned: tuple[float, float, float]
) -> None:
    path = write_calibration(tmp_path / "a.cal", *IDENTITY, transform=(0, 0, 0, *angles_deg))
    assert read_calibration(path).wrench([1, 2, 3, 1, 2, 3])[:3] / 1e3 == pytest.approx(turned)


def test_files_that_cannot_be_used_are_refused_by_name(tmp_path: Path) -> None:
    path = tmp_path / "a.cal"
    for more, message in (
        ({"compensated": "False"}, "compensated for temperature by software"),
        ({"gauges": 5}, "6 gauges, not 5"),
        ({"force": "stone"}, "'stone' is no unit of force"),
        ({"torque": "N-stone"}, "'N-stone' is no unit of torque"),
        ({"length": "stone"}, "'stone' is no unit of length"),
    ):
        with pytest.raises(HardwareError, match=f"a.cal: makes no sense: .*{message}"):
            read_calibration(write_calibration(path, *IDENTITY, **more))  # type: ignore[arg-type]
    with pytest.raises(HardwareError, match="the scale of Fy is 0"):
        read_calibration(write_calibration(path, np.eye(6), np.array([1.0, 0, 1, 1, 1, 1])))
    whole = write_calibration(path, *IDENTITY).read_text()
    for old, new, message in (
        ('Name="Tz"', 'Name="G5"', "a.cal: lacks Tz"),
        ('ForceUnits="N"', "", "lacks ForceUnits"),
        ('max="250"', 'max="much"', "makes no sense"),
        ("</FTSensor>", "", "is no XML"),
        ("Calibration", "Nothing", "has no calibration"),
    ):
        path.write_text(whole.replace(old, new))
        with pytest.raises(HardwareError, match=message):
            read_calibration(path)
    with pytest.raises(HardwareError, match=r"cannot be read .No such file"):
        read_calibration(tmp_path / "none.cal")


def test_a_file_with_two_calibrations_needs_a_choice(tmp_path: Path) -> None:
    path = write_calibration(tmp_path / "a.cal", *IDENTITY)
    text = path.read_text()
    one = text[text.index("  <Calibration") : text.index("</FTSensor>")]
    other = one.replace("SI-18-0.25", "SI-36-0.5").replace('max="18"', 'max="36"')
    path.write_text(text.replace("</FTSensor>", other + "</FTSensor>"))
    with pytest.raises(HardwareError, match=r"has the calibrations SI-18-0\.25, SI-36-0\.5, not None; name one"):
        read_calibration(path)
    assert read_calibration(path, "SI-36-0.5").largest[0] == 36e3


@pytest.mark.parametrize("unit", ["Nm", "N-m", "N·m", "m-N"])
def test_units_of_torque_have_many_names(unit: str) -> None:
    assert force_units.torque_mNm(unit) == 1000


def test_the_sensor_reads_what_loads_the_gauges(calibration: AtiCalibration) -> None:
    zero_V = tuple(np.random.default_rng(3).uniform(-1, 1, 6))
    load = np.zeros(6)
    gauges = AtiGauges(calibration, lambda time_s: load, zero_V=zero_V)
    with sensor(calibration, gauges, bias_readings=20) as wrist:
        assert list(wrist.components) == list(WRENCH) and wrist.components["Tx"].unit == "mN*m"
        wrist.bias()
        load = np.array(LOAD)
        wait_until(lambda: list(wrist.latest().values.values()) == pytest.approx(LOAD, abs=1e-6))
        reading = wrist.latest()
        assert list(reading.unbiased.values()) == pytest.approx(np.array(LOAD) + calibration.wrench(zero_V))
        assert reading.valid


def test_a_saturated_gauge_makes_a_reading_invalid(calibration: AtiCalibration) -> None:
    gauges = [0.0] * 6
    with AtiDaq("wrist", calibration, lambda: gauges, resolution_mN=4, resolution_mNm=0.05, silence_s=0.3) as wrist:
        for voltage_V, is_valid in ((9.89, True), (9.9, False), (-9.91, False), (0.0, True), (float("nan"), False)):
            gauges[2] = voltage_V
            since = wrist.latest().sequence
            wait_until(lambda since=since: wrist.latest().sequence > since + 1)  # type: ignore[misc]
            reading = wrist.latest()
            assert reading.valid == is_valid
            assert is_valid or "gauge G2 is saturated" in (reading.fault or "")
        gauges.append(0.0)
        wait_until(lambda: wrist.latest().fault == "7 voltages came, not 6")


def test_an_overload_saturates_gauges(calibration: AtiCalibration) -> None:
    with sensor(calibration, AtiGauges(calibration, lambda time_s: (1e9,) * 6)) as wrist:
        assert "is saturated" in (wrist.latest().fault or "")


def test_faults_of_the_card_show(calibration: AtiCalibration) -> None:
    gauges = AtiGauges(calibration)
    with sensor(calibration, gauges) as wrist:
        gauges.broken = 4
        wait_until(lambda: "gauge G4" in (wrist.latest().fault or ""))
        gauges.broken = None
        wait_until(lambda: wrist.latest().valid)
        gauges.slow_s = 0.02  # ten readings long
        lost = wrist.latest().lost
        wait_until(lambda: wrist.latest().lost > lost + 20)
        reading = wrist.latest()
        assert reading.valid and reading.sequence > reading.lost
        gauges.slow_s = 0.0
        gauges.unplugged = True
        wait_until(lambda: wrist.latest().fault == "the card does not answer")
        gauges.unplugged = False
        wrist.start()
        assert wrist.latest().valid
    gauges.unplugged = True
    with pytest.raises(HardwareError, match="wrist: the card does not answer; see to it"), sensor(calibration, gauges):
        pass


def test_readings_keep_their_rate(calibration: AtiCalibration) -> None:
    with sensor(calibration, AtiGauges(calibration), rate_Hz=200) as wrist:
        began, first = time.monotonic(), wrist.latest().sequence
        time.sleep(1)
        came = wrist.latest().sequence - first
        assert came == pytest.approx(200 * (time.monotonic() - began), abs=20)
