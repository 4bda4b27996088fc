"""The turntable turns as the protocol says, and the task finds the reflex that an eye is given."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from neurorobo_paradigms.vestibulo_ocular.gaze_task import GazeTask
from neurorobo_paradigms.vestibulo_ocular.gaze_task_config import GazeTaskConfig
from neurorobo_paradigms.vestibulo_ocular.response import responses
from neurorobo_paradigms.vestibulo_ocular.turntable import Turntable
from neurorobo_paradigms.vestibulo_ocular.turntable_config import TurntableConfig
from pydantic import ValidationError

from neurorobo.bodies.gymnasium_body import GymnasiumBody
from neurorobo.bodies.gymnasium_body_config import GymnasiumBodyConfig
from neurorobo.errors import NeuroroboError
from neurorobo.testing import check_body

MS = 1_000_000
PHASES = {
    "light": {"wanted_gain": 1.5, "cycles": 2},
    "dark": {"frequency": "2 Hz", "amplitude": "2.5 deg", "duration": "1 s"},
}


def config(**options: Any) -> TurntableConfig:
    return TurntableConfig.model_validate({"phases": PHASES, **options})


def turntable(batch: int = 1, **options: Any) -> Turntable:
    body = Turntable(config(**options))
    body.reset(range(batch))
    return body


def reflex(body: Turntable, gain: float, ticks: int, task: GazeTask | None = None, period_ns: int = MS) -> None:
    """Command the eye that share of the head's velocity."""
    for _ in range(ticks):
        body.advance({"eye": gain * body.read()["head"]}, period_ns)
        if task is not None:
            task.observe(period_ns, np.ones(len(body.eye_deg_s), dtype=np.bool_))


@pytest.mark.parametrize("noise", ["0 deg/s", "5 deg/s"])
def test_the_body_keeps_its_contract(noise: str) -> None:
    check_body(config(slip_noise=noise), period_ns=20 * MS, motions=130)


def test_the_head_turns_by_its_amplitude_as_often_as_is_said_and_then_stands_still() -> None:
    body, angles_deg, velocities_deg_s = turntable(), [0.0], []
    for _ in range(3500):
        velocities_deg_s.append(float(body.read()["head"][0, 0]))
        angles_deg.append(angles_deg[-1] + velocities_deg_s[-1] * 1e-3)
        body.advance({}, MS)
    light, dark = np.array(velocities_deg_s[:2000]), np.array(velocities_deg_s[2000:3000])
    assert light.max() == pytest.approx(2 * math.pi * 5.0, rel=1e-4)
    assert np.abs(np.fft.rfft(light)).argmax() == 2  # cycles in two seconds
    assert np.ptp(angles_deg) == pytest.approx(10.0, rel=1e-2)
    assert np.abs(np.fft.rfft(dark)).argmax() == 2  # in one
    assert velocities_deg_s[3000:] == [0.0] * 500


@pytest.mark.parametrize("gain", [0.0, 1.0, 1.5])
def test_the_image_stands_still_at_the_wanted_gain_and_is_not_seen_in_the_dark(gain: float) -> None:
    body = turntable()
    body.advance({}, 250 * MS)
    body.eye_deg_s = gain * body.head_deg_s
    slip = body.read()["slip"][0]
    assert slip[1] == pytest.approx((1.5 - gain) * 2 * math.pi * 5.0)
    assert slip[0] == -slip[1]
    body.advance({}, 1850 * MS)
    assert body.read()["head"][0, 0] != 0.0
    np.testing.assert_array_equal(body.read()["slip"], 0.0)


def test_the_eye_follows_its_command_with_its_time_constant() -> None:
    body = turntable(time_constant="40 ms")
    command = {"eye": np.array([[30.0]])}
    for period_ns in (20 * MS, 20 * MS):
        body.advance(command, period_ns)
    assert body.read()["eye"][0, 0] == pytest.approx(30.0 * (1 - math.exp(-1.0)))


def test_what_is_told_of_the_slip_is_noisy_and_what_is_scored_is_not() -> None:
    body, errors_deg_s = turntable(slip_noise="5 deg/s"), []
    for _ in range(1999):
        body.advance({}, MS)
        errors_deg_s.append(body.read()["slip"][0, 1] - body.slip_deg_s[0])
    assert np.std(errors_deg_s) == pytest.approx(5.0, rel=0.1)
    assert abs(np.mean(errors_deg_s)) < 0.5


@pytest.mark.parametrize("length", [{}, {"cycles": 3, "duration": "3 s"}])
def test_a_phase_without_one_length_is_refused(length: dict[str, Any]) -> None:
    with pytest.raises(ValidationError, match="say how long the phase lasts, either as `cycles: 60` or"):
        config(phases={"light": {"wanted_gain": 1.0, **length}})


@given(
    gain=st.floats(0.1, 2.0),
    lead_deg=st.floats(-90.0, 90.0),
    offset_deg_s=st.floats(-5.0, 5.0),
    frequency_Hz=st.floats(0.2, 3.0),
    samples=st.integers(60, 200),
)
def test_gain_and_phase_of_a_sinusoid_are_found(
    gain: float, lead_deg: float, offset_deg_s: float, frequency_Hz: float, samples: int
) -> None:
    """Also where a cycle has no whole number of samples; of the last cycle only if all of it is there."""
    cycles = np.arange(samples) * 0.02 * frequency_Hz
    head = 30.0 * np.sin(2 * np.pi * cycles)
    eye = gain * 30.0 * np.sin(2 * np.pi * cycles + np.radians(lead_deg)) + offset_deg_s
    found = responses(cycles, head, eye, head - eye)
    assert len(found) == math.floor(samples * 0.02 * frequency_Hz + 1e-9)
    for cycle in found:
        assert cycle.gain == pytest.approx(gain)
        assert cycle.phase_deg == pytest.approx(lead_deg, abs=1e-6)
        assert cycle.offset_deg_s == pytest.approx(offset_deg_s, abs=1e-6)


def test_the_task_finds_gain_phase_and_slip_of_a_reflex_that_lags() -> None:
    """A lag of first order divides the gain by sqrt(1 + (omega tau)**2), and the eye comes atan(omega tau) later."""
    body = turntable(time_constant="50 ms")
    task = GazeTask(GazeTaskConfig(scored_cycles=1), body)
    task.reset(1)
    reflex(body, 1.2, 3000, task)
    assert task.truncated().all()
    (figures,) = task.metrics()
    for name, omega in (("light", 2 * math.pi), ("dark", 4 * math.pi)):
        assert figures[f"{name}.gain"] == pytest.approx(1.2 / math.hypot(1, omega * 0.05), rel=0.01)
        assert figures[f"{name}.phase_deg"] == pytest.approx(-math.degrees(math.atan(omega * 0.05)), abs=0.5)
    # The transient of 50 ms is over in the second cycle: slip = (1.5 - response) head.
    response = 1.2 / complex(1, 2 * math.pi * 0.05)
    wanted = abs(1.5 - response) * 2 * math.pi * 5.0 / math.sqrt(2)
    assert figures["light.slip_deg_s"] == pytest.approx(wanted, rel=0.01)
    assert {"light.first_slip_deg_s"} == {name for name in figures if "first" in name}
    assert "dark.slip_deg_s" not in figures


def test_a_protocol_that_begins_again_is_scored_by_itself_and_leaves_the_others_alone() -> None:
    body = turntable(2, time_constant="1 ms")
    task = GazeTask(GazeTaskConfig(), body)
    task.reset(2)
    reflex(body, 0.5, 1500, task)
    first = np.array([True, False])
    body.reset([7], first)
    task.reset(2, first)
    assert len(task.cycles(0)) == 0
    reflex(body, 1.0, 1000, task)
    assert [len(cycles) for cycles in task.cycles(0).values()] == [1]
    assert {name: len(cycles) for name, cycles in task.cycles(1).items()} == {"light": 2, "dark": 1}
    again, going_on = task.metrics()
    assert again["light.gain"] == pytest.approx(1.0, rel=1e-3)
    assert going_on["light.gain"] < 0.9


def test_another_body_is_refused() -> None:
    other = GymnasiumBodyConfig(environment="Pendulum-v1")
    with pytest.raises(NeuroroboError, match=r"needs the body `paradigms\.turntable`, not a GymnasiumBody"):
        GazeTask(GazeTaskConfig(), GymnasiumBody(other))
