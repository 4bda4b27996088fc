import re
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from precision_interaction.rig.insertion_rig import InsertionRig
from precision_interaction.rig.insertion_rig_config import InsertionRigConfig
from precision_interaction.rig.insertion_task import InsertionTask
from precision_interaction.rig.insertion_task_config import InsertionTaskConfig
from pydantic import ValidationError

from neurorobo.bodies import Array, Supervisor
from neurorobo.config.plugged_reader import read_plugged
from neurorobo.errors import ConfigError, NeuroroboError
from neurorobo.plugins import Registry

SECOND_NS = 1_000_000_000


def rig(seeds: Sequence[int] = (0,), **options: object) -> InsertionRig:
    body = InsertionRig(InsertionRigConfig.model_validate(options))
    body.reset(seeds)
    return body


def command(body: InsertionRig, speed: float, move: tuple[float, float] = (0.0, 0.0)) -> dict[str, Array]:
    batch = len(body.travel_um)
    return {"axial_speed": np.full((batch, 1), speed), "radial_move": np.tile(np.array(move), (batch, 1))}


def drive(body: InsertionRig, speeds: Sequence[float]) -> None:
    for speed in speeds:
        body.advance(command(body, speed), SECOND_NS)


def test_there_is_no_force_before_the_gap_is_closed_and_some_after() -> None:
    body = rig(range(20))
    drive(body, [20.0, 30.0])
    np.testing.assert_array_equal(body.force_mN, 0.0)
    drive(body, [10.0])
    assert np.all(body.force_mN[:, 1] > 0)


def test_a_radial_move_lowers_the_force_by_stiffness_times_the_rounded_move() -> None:
    body = rig()
    body.advance(command(body, 0.0, (1.3, -0.2)), SECOND_NS)
    np.testing.assert_allclose(body.stage_um, [[1.5, 0.0]])
    np.testing.assert_allclose(body.force_mN, [[-120.0, 0.0, 0.0]])
    body.advance(command(body, 0.0, (-0.3, 0.0)), SECOND_NS)  # from the position read back, not from the one wanted
    np.testing.assert_allclose(body.stage_um, [[1.0, 0.0]])


def test_the_stiffness_changes_where_it_is_to_and_for_each_rig_by_itself() -> None:
    body = rig((0, 1), gap="2000 um", stiffness_change={"at": "40 um", "to": "120 mN/um"})
    for speeds, change_mN in (((30.0, 50.0), (-80.0, -80.0)), ((0.0, 0.0), (-80.0, -120.0))):
        before_mN = body.force_mN[:, 0].copy()
        moves = {"axial_speed": np.array(speeds)[:, None], "radial_move": np.array([[1.0, 0.0]] * 2)}
        body.advance(moves, SECOND_NS)
        np.testing.assert_allclose(body.force_mN[:, 0] - before_mN, change_mN)


def test_a_change_that_is_never_reached_changes_nothing() -> None:
    plain, late = rig(range(3)), rig(range(3), stiffness_change={"at": "2000 um", "to": "1 mN/um"})
    for body in (plain, late):
        for _ in range(5):
            body.advance(command(body, 60.0, (0.3, 0.6)), SECOND_NS)
    np.testing.assert_array_equal(plain.force_mN, late.force_mN)
    assert "stiffness_change" not in plain.config.model_dump()


def test_sensors_report_in_their_counts_and_saturate() -> None:
    body = rig(stage_resolution="0.1 um", force_range="-50..50 mN")
    body.advance(command(body, 12.34, (0.4, 1.0)), SECOND_NS)
    reading = body.read()
    np.testing.assert_allclose(reading["force"], [[-31.25, -50.0]])  # -32 mN is nearest to 4 counts of 7.8125 mN
    np.testing.assert_allclose(reading["travel"], [[12.3]])
    np.testing.assert_allclose(reading["remaining"], [[2037.7]])
    np.testing.assert_allclose(reading["stage"], [[0.4, 1.0]])


def test_readings_have_the_declared_widths() -> None:
    body = rig(range(3))
    assert {name: values.shape for name, values in body.read().items()} == {
        name: (3, sensor.width) for name, sensor in body.sensors.items()
    }


def test_what_happens_to_a_rig_does_not_depend_on_its_batch() -> None:
    alone, together = rig([7]), rig([5, 7, 9])
    drive(alone, [40.0] * 5)
    drive(together, [40.0] * 5)
    np.testing.assert_array_equal(alone.force_mN[0], together.force_mN[1])
    assert not np.array_equal(together.force_mN[0], together.force_mN[2])


def test_a_partial_reset_leaves_the_others_alone_and_equals_a_fresh_start() -> None:
    body, undisturbed = rig([1, 2]), rig([1, 2])
    drive(body, [40.0] * 3)
    drive(undisturbed, [40.0] * 6)
    body.reset([8], np.array([False, True]))
    drive(body, [40.0] * 3)
    fresh = rig([8])
    drive(fresh, [40.0] * 3)
    np.testing.assert_array_equal(body.force_mN, [undisturbed.force_mN[0], fresh.force_mN[0]])


def test_an_axial_move_adds_the_same_force_however_fast_the_radial_loop_is() -> None:
    """The intercept of the measured law comes once per axial move."""
    seeds = range(1000)
    slow, fast = rig(seeds, gap="0 um"), rig(seeds, gap="0 um")
    drive(slow, [50.0])
    for _ in range(5):
        fast.advance({"axial_speed": np.full((1000, 1), 50.0)}, SECOND_NS // 5)
    expected, deviation = np.array([29.6, 51.7]), np.sqrt([56.3, 26.4])
    for body in (slow, fast):
        force = body.force_mN[:, :2]
        assert np.all(np.abs(force.mean(axis=0) - expected) < 4 * deviation / np.sqrt(1000))
        np.testing.assert_allclose(force.std(axis=0), deviation, rtol=0.1)
    np.testing.assert_allclose(slow.travel_um, fast.travel_um)


def test_a_held_speed_needs_no_new_command_and_stop_ends_it() -> None:
    body = rig()
    drive(body, [10.0])
    body.advance({}, SECOND_NS)
    np.testing.assert_allclose(body.travel_um, 20.0)
    body.stop()
    body.advance({}, SECOND_NS)
    np.testing.assert_allclose(body.travel_um, 20.0)


def test_slow_speeds_add_up_although_each_tick_is_finer_than_the_elevator() -> None:
    body = rig()
    for _ in range(20):
        body.advance({"axial_speed": np.array([[0.9]])}, SECOND_NS // 20)
    np.testing.assert_allclose(body.travel_um, 0.9)


def axial_limits(body: InsertionRig) -> tuple[float, float]:
    lo, hi = body.limits(SECOND_NS)["axial_speed"]
    return lo.item(), hi.item()


def test_the_axial_speed_is_limited_by_acceleration_creep_maximum_and_distance() -> None:
    body = rig(elevator_resolution="0 um", length="300 um")
    assert axial_limits(body) == pytest.approx((2.0, 22.0))
    drive(body, [22.0, 42.0])
    assert axial_limits(body) == pytest.approx((22.0, 62.0))
    drive(body, [62.0, 82.0])
    assert axial_limits(body) == pytest.approx((62.0, 92.0))  # 92 um are left
    drive(body, [91.0])
    assert axial_limits(body) == pytest.approx((1.0, 1.0))  # the distance wins over acceleration and creep
    drive(body, [1.0])
    assert axial_limits(body) == pytest.approx((0.0, 0.0))


def test_within_an_axial_move_the_limits_allow_its_speed() -> None:
    body = rig()
    speed = axial_limits(body)[1]
    for _ in range(4):
        lo, hi = axial_limits(body)
        assert lo <= speed <= hi + 1e-9
        body.advance({"axial_speed": np.array([[speed]])}, SECOND_NS // 4)


@given(
    speeds=st.lists(st.floats(-50.0, 250.0), min_size=1, max_size=12),
    ticks=st.sampled_from([1, 4, 5]),
    length=st.floats(60.0, 400.0),
)
@settings(max_examples=60, deadline=None)
def test_behind_the_command_layer_no_speed_passes_the_end(speeds: list[float], ticks: int, length: float) -> None:
    body = rig(length=f"{length!r} um")
    supervisor = Supervisor(body)
    supervisor.reset(1)
    running: NDArray[np.bool_] = np.ones(1, dtype=np.bool_)
    for speed in speeds * 4:
        for tick in range(ticks):
            wanted = {"axial_speed": np.array([[speed]])} if tick == 0 else {}
            supervisor.advance(wanted, SECOND_NS // ticks, running)
        assert body.travel_um[0] <= length


def test_a_motion_longer_than_an_axial_move_is_refused() -> None:
    body = rig(axial_period="500 ms")
    with pytest.raises(NeuroroboError, match="1 s does not fit into axial moves of 500 ms"):
        body.advance(command(body, 10.0), SECOND_NS)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"gap": "3 mm"}, "gap .* must be shorter"),
        ({"creep_speed": "200 um/s"}, "exceeds max_speed"),
        ({"stiffness": "0 mN/um"}, "greater than 0 mN/um"),
        ({"axial_period": "0 s"}, "greater than 0"),
        ({"stage_resolution": 0.5}, "needs a unit"),
    ],
)
def test_an_impossible_rig_is_refused(options: dict[str, object], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        InsertionRigConfig.model_validate(options)


def test_the_config_survives_a_round_trip_through_its_dump() -> None:
    config = InsertionRigConfig.model_validate({"contact": {"law": "proportional"}, "axial_period": "500 ms"})
    assert InsertionRigConfig.model_validate(config.model_dump()) == config


# --- the task


def insertion(body: InsertionRig, **options: object) -> InsertionTask:
    task = InsertionTask(InsertionTaskConfig.model_validate(options), body)
    task.reset(len(body.travel_um))
    return task


def step(task: InsertionTask, running: Sequence[bool], speed: float, move: tuple[float, float] = (0.0, 0.0)) -> None:
    task.body.advance(command(task.body, speed, move), SECOND_NS)
    task.observe(SECOND_NS, np.array(running))


def test_the_figures_of_a_run_by_hand() -> None:
    task = insertion(rig(length="100 um", gap="99 um", contact={"law": "proportional", "mean_slope": ["0 mN/um"] * 3}))
    step(task, [True], 50.0, (0.5, 0.0))  # 40 mN
    step(task, [True], 49.5, (0.0, 1.0))  # (40, 80) mN, and the noise of the last half micrometre
    assert task.terminated().tolist() == [True]
    force_mN = float(np.hypot(*task.body.force_mN[0, :2]))
    assert force_mN == pytest.approx(np.hypot(40, 80), abs=5)
    (figures,) = task.metrics()
    assert figures == pytest.approx({
        "steps": 2, "duration_s": 2, "mean_force_mN": (40 + force_mN) / 2, "max_force_mN": force_mN,
        "final_error_um": 0.5, "overshoot_um": 0, "success": 1,
    })  # fmt: skip


def test_an_episode_that_has_ended_keeps_its_figures() -> None:
    task = insertion(rig([0, 1], length="60 um"))
    step(task, [True, True], 30.0)
    step(task, [True, True], 30.0)
    before = task.metrics()[0]
    step(task, [False, True], 30.0, (2.0, 2.0))
    assert task.metrics()[0] == before
    assert task.terminated().tolist() == [True, True]


def test_passing_the_end_ends_the_episode_as_a_failure() -> None:
    task = insertion(rig(length="60 um"))
    step(task, [True], 60.5)
    assert task.terminated()[0]
    (figures,) = task.metrics()
    assert figures["overshoot_um"] == pytest.approx(0.5)
    assert figures["final_error_um"] == pytest.approx(0.5)
    assert figures["success"] == 0


def test_an_episode_ends_with_its_last_axial_move_not_within_it() -> None:
    task = insertion(rig(length="60 um"))
    ended = []
    for _ in range(4):
        task.body.advance({"axial_speed": np.array([[60.0]])}, SECOND_NS // 4)
        task.observe(SECOND_NS // 4, np.array([True]))
        ended.append(bool(task.terminated()[0]))
    assert ended == [False, False, False, True]
    assert task.metrics()[0]["steps"] == 1


def test_an_episode_fails_at_the_time_limit() -> None:
    task = insertion(rig(), time_limit="3 s")
    for expected in (False, False, True):
        step(task, [True], 2.0)
        assert task.truncated().tolist() == [expected]
    assert not task.terminated()[0]
    assert task.metrics()[0]["success"] == 0


def test_the_reward_is_eq_13_in_its_units() -> None:
    task = insertion(rig(length="1050 um", gap="1000 um"), force_weight=2.0)
    step(task, [True], 50.0, (0.5, -1.0))  # 1000 um left, force (-40, 80) mN
    assert task.reward()[0] == pytest.approx(-(1.0**2 - 0.001**2) - 2.0 * (2.0**2 + 4.0**2))


def test_a_reset_of_some_episodes_starts_their_figures_anew() -> None:
    task = insertion(rig([0, 1]))
    step(task, [True, True], 20.0, (1.0, 0.0))
    task.body.reset([5], np.array([True, False]))
    task.reset(2, np.array([True, False]))
    first, second = task.metrics()
    assert (first["steps"], first["max_force_mN"]) == (0, 0)
    assert (second["steps"], second["max_force_mN"]) == (1, 80)


@pytest.mark.parametrize(
    ("slopes", "message"),
    [
        (["1 mN/um", "2 mN/um"], "contact.mean_slope.2: is missing: the list has 2 values and needs more; add it"),
        (["1 mN/um"] * 4, "contact.mean_slope: has 4 values, and takes at most 3; remove the rest"),
    ],
)
def test_a_law_of_too_few_or_too_many_axes_is_refused_with_the_cure(slopes: list[str], message: str) -> None:
    contact = {"law": "proportional", "mean_slope": slopes}
    with pytest.raises(ConfigError, match=re.escape(message)):
        read_plugged("body", {"type": "precision.insertion_rig", "contact": contact}, Registry.discover())
