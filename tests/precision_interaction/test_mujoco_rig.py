"""The insertion body whose contact MuJoCo solves: its forces are its springs', and it is a body like any other."""

from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from precision_interaction.identification.analysis import analyse
from precision_interaction.identification.experiment import insert_and_withdraw
from precision_interaction.rig.identified_law_config import IdentifiedLawConfig
from precision_interaction.rig.insertion_rig_config import InsertionRigConfig
from precision_interaction.rig.insertion_task import InsertionTask
from precision_interaction.rig.insertion_task_config import InsertionTaskConfig
from precision_interaction.rig.mujoco_rig import MujocoRig
from precision_interaction.rig.mujoco_rig_config import MujocoRigConfig
from precision_interaction.teachers.contact_expectation_config import ContactLawConfig
from pydantic import ValidationError

from neurorobo.bodies import Array
from neurorobo.config.experiment import load_experiment
from neurorobo.errors import NeuroroboError
from neurorobo.experiment.build import build_task
from neurorobo.experiment.lessons import read_lessons
from neurorobo.plugins import Registry
from neurorobo.testing import check_region

EXAMPLES = Path(__file__).parents[2] / "examples"
SECOND_NS = 1_000_000_000

needs_mujoco = pytest.mark.skipif(find_spec("mujoco") is None, reason="the extra `mujoco` is not installed")


def config(**options: Any) -> MujocoRigConfig:
    """A rig with a short hole, read exactly."""
    return MujocoRigConfig.model_validate({"length": "300 um", "stage_resolution": "0 um", **options})


def rig(seeds: Sequence[int] = (0,), **options: Any) -> MujocoRig:
    body = MujocoRig(config(**options))
    body.reset(seeds)
    return body


def drive(body: MujocoRig, speed: float, move: tuple[float, float] = (0.0, 0.0), seconds: int = 1) -> Array:
    batch = len(body.travel_um)
    for _ in range(seconds):
        moves = np.tile(np.array(move), (batch, 1))
        body.advance({"axial_speed": np.full((batch, 1), speed), "radial_move": moves}, SECOND_NS)
    return body.force_mN.copy()


STRAIGHT: dict[str, Any] = {"tilt": ["0 mrad", "0 mrad"], "wander": ["0 um", "0 um"]}


@needs_mujoco
def test_a_radial_move_lowers_the_force_by_the_tool_and_the_rings_in_series() -> None:
    """Segments give way in series with their contacts, all of these side by side, and in series with them the tool."""
    import mujoco

    body = rig(friction=0.0, **STRAIGHT)
    drive(body, 75.0, seconds=2)
    before = drive(body, 0.0)
    after = drive(body, 0.0, (0.5, 0.0))
    (one,) = body.rigs
    rings_mN_um, push = 0.0, np.zeros(6)
    for i, contact in enumerate(one.data.contact):
        mujoco.mj_contactForce(one.model, one.data, i, push)
        contact_mN_um = push[0] / -contact.dist * contact.frame[0] ** 2  # along x; 0 for the segments beside it
        if contact_mN_um > 1:
            rings_mN_um += 1 / (1 / 300.0 + 1 / contact_mN_um)
    assert rings_mN_um > 500
    assert (before - after)[0, 0] / 0.5 == pytest.approx(1 / (1 / 88.0 + 1 / rings_mN_um), rel=0.005)
    assert abs((before - after)[0, 1]) < 0.01  # the axes do not mix


@needs_mujoco
def test_the_sensor_reads_what_the_springs_of_tool_and_hole_take() -> None:
    """At rest and without friction, one force in three places: in the sensor, in the tool, and in the segments.

    As the peg is not in the middle, what a segment pushes is not quite along its own slide: by 1.6 um of 2000 um.
    """
    body = rig([3], friction=0.0)
    drive(body, 50.0, seconds=4)
    force_mN = drive(body, 0.0, seconds=6)[0]
    (one,) = body.rigs
    model, data = one.model, one.data
    tool = np.array([data.joint(f"tool_{axis}").qpos[0] for axis in "xyz"])
    stiffness = np.array([model.joint(f"tool_{axis}").stiffness[0] for axis in "xyz"])
    np.testing.assert_allclose(force_mN, tool * stiffness, atol=0.02)
    pushes = np.zeros(3)
    for joint in (model.joint(i) for i in range(model.njnt)):
        if joint.name.split("_")[0] in ("right", "left", "far", "near"):
            pushes -= model.jnt_axis[joint.id] * joint.stiffness[0] * data.joint(joint.id).qpos[0]
    np.testing.assert_allclose(force_mN[:2], pushes[:2], rtol=1e-3)
    assert np.all(force_mN[:2] > 20)


@needs_mujoco
def test_the_force_grows_with_the_tilt_of_the_hole_and_not_before_the_gap_is_closed() -> None:
    body = rig(range(4), wander=["0 um", "0 um"], tilt=["5 mrad", "-10 mrad"])
    np.testing.assert_array_equal(drive(body, 50.0), 0.0)
    drive(body, 50.0)
    before = drive(body, 0.0)
    grown_mN_um = (drive(body, 50.0, seconds=2) - before)[:, :2] / 100.0
    assert np.all(np.abs(grown_mN_um / (80.0 * np.array([0.005, -0.010])) - 1) < 0.15)


@needs_mujoco
def test_friction_holds_the_peg_back_along_the_axis_only() -> None:
    rough, smooth = rig(friction=0.2), rig(friction=0.0)
    held, free = drive(rough, 50.0, seconds=3)[0], drive(smooth, 50.0, seconds=3)[0]
    assert held[2] > free[2] + 50


@needs_mujoco
def test_the_same_seed_gives_the_same_forces_in_whatever_batch_and_another_one_others() -> None:
    alone, together = rig([7]), rig([5, 7, 9])
    drive(alone, 60.0, (0.2, 0.4), 3)
    drive(together, 60.0, (0.2, 0.4), 3)
    np.testing.assert_array_equal(alone.force_mN[0], together.force_mN[1])
    assert not np.array_equal(together.force_mN[0], together.force_mN[2])


@needs_mujoco
def test_a_partial_reset_leaves_the_others_alone_and_equals_a_fresh_start() -> None:
    body, undisturbed, fresh = rig([1, 2]), rig([1, 2]), rig([8])
    drive(body, 60.0, seconds=2)
    drive(undisturbed, 60.0, seconds=4)
    body.reset([8], np.array([False, True]))
    drive(body, 60.0, seconds=2)
    drive(fresh, 60.0, seconds=2)
    np.testing.assert_array_equal(body.force_mN, [undisturbed.force_mN[0], fresh.force_mN[0]])


@needs_mujoco
def test_rings_out_of_reach_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """More rings at once, of which the further ones touch nothing, give the same forces."""
    from precision_interaction.rig import mujoco_model

    few = rig([4])
    drive(few, 70.0, (0.1, 0.3), 3)
    sized = mujoco_model.simulated_rings(config())
    depth, centre = mujoco_model.draw_rings(config(), np.random.default_rng(4))
    monkeypatch.setattr(mujoco_model, "simulated_rings", lambda _: sized + 5)
    monkeypatch.setattr(
        mujoco_model, "draw_rings", lambda *_: (np.append(depth, [1e6] * 5), np.pad(centre, ((0, 5), (0, 0))))
    )
    many = rig([4])
    drive(many, 70.0, (0.1, 0.3), 3)
    assert many.rigs[0].model.nv == few.rigs[0].model.nv + 20
    np.testing.assert_allclose(many.force_mN, few.force_mN, rtol=1e-6, atol=1e-6)


@needs_mujoco
def test_it_is_the_same_body_to_a_brain_and_to_the_task() -> None:
    ours, other = config(), InsertionRigConfig.model_validate({"length": "300 um", "stage_resolution": "0 um"})
    assert ours.actuators() == other.actuators()
    assert ours.sensors().keys() == other.sensors().keys()
    body = rig([0, 1])
    drive(body, 40.0)
    for name, reading in body.read().items():
        assert reading.shape == (2, body.sensors[name].width)
    assert isinstance(InsertionTask(InsertionTaskConfig(), body).body, MujocoRig)


@needs_mujoco
def test_a_motion_that_is_no_multiple_of_the_time_step_is_refused() -> None:
    with pytest.raises(NeuroroboError, match=r"7 ms is no multiple of `body\.time_step`, 5 ms"):
        rig().advance({}, 7_000_000)


@needs_mujoco
def test_a_simulation_that_blows_up_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # MuJoCo keeps a log of its own there
    body = rig(**STRAIGHT)
    body.rigs[0].data.qvel[:] = np.inf
    with pytest.raises(NeuroroboError, match="became unstable"):
        drive(body, 10.0)


def test_without_mujoco_the_file_is_valid_and_building_it_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("precision_interaction.rig.mujoco_rig.find_spec", lambda name: None)
    experiment = load_experiment(EXAMPLES / "peg_in_hole_mujoco.yaml")
    with pytest.raises(NeuroroboError, match=r"peg_in_hole_mujoco.yaml:9:.*\[mujoco\]"):
        build_task(experiment)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"max_speed": "2 mm/s"}, "passes more than one ring_pitch"),
        ({"time_step": "10 ms"}, r"time_step \(10 ms\) must be at most 5 ms"),
        ({"time_step": "3 ms"}, "must be a multiple of time_step"),
        ({"interference": "20 um"}, "less than 10 um"),
        ({"gap": "3 mm"}, "gap .* must be shorter"),
        ({"contact": {"law": "table", "points": []}}, "law"),
    ],
)
def test_an_impossible_rig_is_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        config(**options)


def test_the_example_differs_from_the_paper_rig_in_the_body_alone() -> None:
    ours, other = (load_experiment(EXAMPLES / f"{name}.yaml") for name in ("peg_in_hole_mujoco", "peg_in_hole"))
    differing = {key for key in type(ours).model_fields if getattr(ours, key) != getattr(other, key)}
    assert differing == {"name", "body"}


# --- what is identified, and how it is taught


@needs_mujoco
def test_what_identification_finds_is_the_tilt_and_the_wander_of_the_hole() -> None:
    """Within five standard errors and what the felt stiffness is uncertain by."""
    body = config(tilt=["8 mrad", "-4 mrad"], wander=["0.3 um", "0.6 um"], force_resolution="0 mN")
    found = analyse(insert_and_withdraw(body, steps_um=(20.0, 40.0), repetitions=40, depth_um=40.0)).proportional
    slope, error = found.mean.slope[:2], found.mean.slope_error[:2]
    assert np.all(np.abs(slope - 80.0 * np.array([0.008, -0.004])) < 5 * error + 0.05)
    variance, error = found.variance.slope[:2], found.variance.slope_error[:2]
    assert np.all(np.abs(variance - 6.4 * np.array([0.09, 0.36])) < 5 * error)


CONTACT = {
    "law": "measured",
    "mean_slope": ["0.3 mN/um", "0.7 mN/um", "0 mN/um"],
    "mean_intercept": ["2 mN", "-1 mN", "0 mN"],
    "variance_slope": ["1 mN^2/um", "2 mN^2/um", "0 mN^2/um"],
    "variance_intercept": ["3 mN^2", "0 mN^2", "0 mN^2"],
}


def test_the_law_of_an_identified_contact_adds_up_period_by_period() -> None:
    from precision_interaction.rig.identified_law import IdentifiedLaw

    from neurorobo.clock import Clock

    clock = Clock({"control": SECOND_NS, "radial": SECOND_NS // 5}, 1_000_000, 50)
    law = IdentifiedLaw(IdentifiedLawConfig.model_validate({"contact": CONTACT}), clock, torch.Generator())
    fed = {"mean_feedback": torch.zeros(2, 2), "variance_feedback": torch.zeros(2, 2)}
    for _ in range(5):  # the radial periods of one axial move
        out, _ = law.step({"speed": torch.tensor([[50.0], [0.0]]), **fed}, {})
        fed = {"mean_feedback": out["mean"], "variance_feedback": out["variance"]}
    torch.testing.assert_close(out["mean"], torch.tensor([[17.0, 34.0], [0.0, 0.0]]))
    torch.testing.assert_close(out["variance"], torch.tensor([[53.0, 100.0], [0.0, 0.0]]))


def test_the_teacher_of_an_identified_contact_keeps_the_contract() -> None:
    check_region(IdentifiedLawConfig.model_validate({"contact": CONTACT, "period": "control"}))


def test_training_teaches_what_was_identified_on_the_body_and_says_so() -> None:
    registry = Registry.discover()
    experiment = load_experiment(EXAMPLES / "peg_in_hole_mujoco.yaml", registry=registry)
    assert isinstance(experiment.body, MujocoRigConfig)
    for lesson in read_lessons(experiment, registry):
        if "hippocampus" in lesson.phase.pupils:
            assert isinstance(lesson.teacher, IdentifiedLawConfig)
            assert lesson.teacher.contact == experiment.body.contact
            assert lesson.phase.model_dump(mode="json")["teacher"]["contact"]["law"] == "measured"
        else:
            assert not isinstance(lesson.teacher, ContactLawConfig | IdentifiedLawConfig)
    without = load_experiment(EXAMPLES / "peg_in_hole_mujoco.yaml", ["body.contact=null"], registry)
    first, *_ = read_lessons(without, registry)
    assert isinstance(first.teacher, ContactLawConfig)
