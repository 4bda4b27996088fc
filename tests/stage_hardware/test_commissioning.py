"""``neurorobo rig``: from a rig file to one that is ready, on emulated devices, as a person does it."""

import math
import statistics
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import yaml
from click.testing import CliRunner, Result
from stage_hardware.force_sensor import ForceReading
from stage_hardware.rig.commissioning.command import rig as command
from stage_hardware.rig.commissioning.dialogue import Dialogue
from stage_hardware.rig.commissioning.moves import Moves, _lines, _speed_um_s
from stage_hardware.rig.commissioning.record import Check, Commissioning
from stage_hardware.rig.emulated_rig import EmulatedRig
from stage_hardware.rig.rig_config import load_rig

from neurorobo.errors import NeuroroboError
from neurorobo.safety.guard import Trip
from neurorobo.safety.machine import Latch
from tests.stage_hardware.rigs import SENSOR, WALL, loaded, registry, rig, written

WALL_UM, STIFFNESS_MN_UM = 1000.0, -2.0
LIMIT = ("--limit", "500 mN")
STEPS = ("--within", "2mm", "--step", "300um")
TOUCH = ("--touch", "x", "--within", "1200um", "--step", "50um")


@pytest.fixture(autouse=True)
def listening_briefly(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("stage_hardware.rig.commissioning.check.LISTENS_S", 0.5)


@pytest.fixture
def emulated(tmp_path: Path) -> Iterator[EmulatedRig]:
    """Two axes on emulated controllers, the first of which runs into a wall 1 mm from where episodes begin."""
    with EmulatedRig(loaded(tmp_path, rig("pi_gcs", emulate=WALL))) as running:
        written(tmp_path, running.config.dump())
        yield running


def call(folder: Path, step: str, *arguments: str, typed: str | None = None) -> Result:
    agrees = ("--yes",) if typed is None and step not in ("check", "reset") else ()
    arguments = (step, str(folder / "rig.yaml"), *arguments, *agrees)
    return CliRunner().invoke(command, list(arguments), input=typed, catch_exceptions=False)


def refused(folder: Path, step: str, *arguments: str, typed: str | None = None) -> str:
    with pytest.raises(NeuroroboError) as error:
        call(folder, step, *arguments, typed=typed)
    return str(error.value)


def test_a_rig_is_commissioned_step_by_step(tmp_path: Path, emulated: EmulatedRig) -> None:
    told = call(tmp_path, "check").output
    assert "not referenced" in told
    assert f"next: neurorobo rig home {tmp_path / 'rig.yaml'}" in told
    told = call(tmp_path, "home", *LIMIT).output
    assert "home x? It looks for its origin at up to 10000 um/s" in told
    call(tmp_path, "identify", *TOUCH, "--amplitude", "15um")
    told = call(tmp_path, "calibrate", *TOUCH, "--clearance", "100um").output
    assert "`radial`, `force` and `force_signs` are left out" in told
    record = Commissioning(tmp_path / "rig.yaml", registry()).record
    assert record.home is not None
    assert record.home.limit_mN == 500
    assert set(record.home.took_s) == {"x", "y"}
    assert record.identify is not None
    for run in record.identify.axes.values():
        assert run.speed_um_s == pytest.approx(10_000, rel=0.1)
        assert run.off_um <= 0.5
    (response,) = record.identify.responses.values()
    assert (response.component, response.stiffness_mN_um) == ("Fy", pytest.approx(STIFFNESS_MN_UM, rel=0.1))
    assert record.calibrate is not None
    needed_um = 20 / -STIFFNESS_MN_UM  # the load that counts as contact, 5 steps of the sensor
    for touch_um in record.calibrate.touches_um:
        assert WALL_UM + needed_um <= touch_um + 1e-6 < WALL_UM + needed_um + 50 + 3
    calibrated = load_rig(tmp_path / "rig.calibrated.yaml", registry())
    original = load_rig(tmp_path / "rig.yaml", registry())
    begins_um = original.frames["x"].to_rig(calibrated.frames["x"].start)
    assert begins_um == pytest.approx(statistics.fmean(record.calibrate.touches_um) - 100, abs=0.01)
    assert calibrated.frames["y"] == original.frames["y"]
    body = yaml.safe_load((tmp_path / "rig.calibrated.body.yaml").read_text())
    assert body["rig"] == str(tmp_path / "rig.calibrated.yaml")
    assert (body["axial"], body["axial_force"], body["gap"]) == ("x", "Fy", "100 um")
    assert set(body["safety"]["force"]) == {"stop", "latch", "rate", "age"}
    assert (body["elevator_resolution"], body["overrun"]) == ("0.01 um", "stop")


def test_each_step_needs_the_one_before_of_the_same_rig_file(tmp_path: Path, emulated: EmulatedRig) -> None:
    before = emulated.positions()
    assert "needs `neurorobo rig check" in refused(tmp_path, "home", *LIMIT)
    call(tmp_path, "check")
    path = tmp_path / "rig.yaml"
    for arguments in (["identify"], ["calibrate", *TOUCH, *LIMIT]):
        told = refused(tmp_path, *arguments)
        assert f"needs `neurorobo rig home {path} --limit 0.5N` first; that was not done yet" in told
    path.write_text(path.read_text().replace("name: bench", "name: another"))
    for arguments in (["home", *LIMIT], ["identify"]):
        told = refused(tmp_path, *arguments)
        assert f"needs `neurorobo rig check {path}` first; the rig file has changed since" in told
    assert emulated.positions() == before


@pytest.mark.parametrize(("typed", "words"), [("", "nobody to answer"), ("n\n", "goes on from here")])
def test_nothing_moves_that_nobody_agreed_to(tmp_path: Path, emulated: EmulatedRig, typed: str, words: str) -> None:
    call(tmp_path, "check")
    before = emulated.positions()
    assert words in refused(tmp_path, "home", *LIMIT, typed=typed)
    assert emulated.positions() == before


def test_homing_goes_on_where_it_was_left(tmp_path: Path, emulated: EmulatedRig) -> None:
    call(tmp_path, "check")
    before = emulated.positions()
    refused(tmp_path, "home", *LIMIT, typed="y\nn\n")
    assert emulated.positions()["x"] != before["x"]
    assert emulated.positions()["y"] == before["y"]
    assert "y was not homed yet" in refused(tmp_path, "identify")
    told = call(tmp_path, "home", *LIMIT, typed="y\n").output
    assert "home y?" in told
    assert "home x?" not in told
    assert "--axis" in call(tmp_path, "home", *LIMIT).output
    assert "home x?" in call(tmp_path, "home", *LIMIT, "--axis", "x").output


def test_too_large_a_load_stops_a_touch_and_draws_it_back(tmp_path: Path, emulated: EmulatedRig) -> None:
    call(tmp_path, "check")
    call(tmp_path, "home", *LIMIT)
    told = refused(tmp_path, "identify", "--axis", "y", "--touch", "x", *STEPS, "--limit", "300 mN")
    assert "load: " in told
    assert "300 mN allowed" in told
    assert "drawn back by" in told
    assert emulated.positions()["x"] < WALL_UM
    assert "y: its free run is known already" in call(tmp_path, "identify", "--axis", "y").output


def test_what_is_not_there_is_not_touched(tmp_path: Path, emulated: EmulatedRig) -> None:
    call(tmp_path, "check")
    call(tmp_path, "home", *LIMIT)
    arguments = ("identify", "--axis", "y", "--touch", "x", "--within", "100um", "--step", "50um")
    assert "nothing was touched within 100 um" in refused(tmp_path, *arguments)
    assert emulated.positions()["x"] == pytest.approx(0, abs=1)


def test_a_person_jogs_to_where_the_parts_are_in_line(tmp_path: Path, emulated: EmulatedRig) -> None:
    call(tmp_path, "check")
    call(tmp_path, "home", *LIMIT)
    call(tmp_path, "identify")
    jogs = "y\ny 120 um\ny 9 mm\nz 1 um\ny 3\n\ny\n"
    told = call(tmp_path, "calibrate", *TOUCH, "--times", "1", typed=jogs).output
    assert "beyond -2500..2500 um" in told
    assert "there is no axis `z`" in told
    assert "unit" in told
    calibrated, original = (load_rig(tmp_path / name, registry()) for name in ("rig.calibrated.yaml", "rig.yaml"))
    assert original.frames["y"].to_rig(calibrated.frames["y"].start) == pytest.approx(120, abs=1)


def test_a_calibration_writes_over_nothing_else(tmp_path: Path, emulated: EmulatedRig) -> None:
    call(tmp_path, "check")
    call(tmp_path, "home", *LIMIT)
    call(tmp_path, "identify")
    mine = tmp_path / "mine.yaml"
    mine.write_text("kept")
    before = emulated.positions()
    assert "left as it is" in refused(tmp_path, "calibrate", *TOUCH, "--out", str(mine))
    assert mine.read_text() == "kept"
    assert emulated.positions() == before


def test_a_check_tells_of_every_device_and_notes_nothing_if_one_is_faulty(
    tmp_path: Path, emulated: EmulatedRig
) -> None:
    emulated.controllers["controller_0"].emulator.faults.no_reply = 100
    told = refused(tmp_path, "check")
    assert told.startswith("controller_0: ")
    assert not (tmp_path / "rig.commissioning.yaml").exists()


def test_a_sensor_that_is_loaded_already_is_refused(tmp_path: Path) -> None:
    pushed = {"physics": {**WALL["physics"], "at": "-10 mm", "stiffness": "1 mN/um"}}
    with EmulatedRig(loaded(tmp_path, rig("pi_gcs", emulate=pushed))) as running:
        written(tmp_path, running.config.dump())
        assert "Fy stands at" in refused(tmp_path, "check")


def test_a_reading_that_is_no_number_is_refused(
    tmp_path: Path, emulated: EmulatedRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    call(tmp_path, "check")
    whole = ForceReading.__init__

    def spoilt(self: ForceReading, *arguments: object, **named: object) -> None:
        whole(self, *arguments, **named)  # type: ignore[arg-type]
        object.__setattr__(self, "unbiased", {name: math.nan for name in self.unbiased})

    monkeypatch.setattr(ForceReading, "__init__", spoilt)
    assert "reports what is no number" in refused(tmp_path, "check")


def test_contacts_that_scatter_are_no_start(
    tmp_path: Path, emulated: EmulatedRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    call(tmp_path, "check")
    call(tmp_path, "home", *LIMIT)
    call(tmp_path, "identify")
    contacts_um = iter([1000.0, 1060.0, 1000.0])
    monkeypatch.setattr(Moves, "touch", lambda *_: next(contacts_um))
    told = refused(tmp_path, "calibrate", *TOUCH, "--clearance", "100um", "--times", "3")
    assert "x: contacts are 60 um apart" in told
    assert not (tmp_path / "rig.calibrated.yaml").exists()


def test_a_latched_rig_stays_so_until_a_person_resets_it(tmp_path: Path, emulated: EmulatedRig) -> None:
    call(tmp_path, "check")
    Latch(tmp_path / "bench.latch.json").set(Trip("force", "9 N, of 3 N allowed", "look at it", "latch"))
    told = call(tmp_path, "check").output
    assert "it is latched: force: 9 N, of 3 N allowed" in told
    assert told.endswith(f"next: neurorobo rig reset {tmp_path / 'rig.yaml'}\n")
    assert f"then `neurorobo rig reset {tmp_path / 'rig.yaml'}`" in refused(tmp_path, "home", *LIMIT)
    assert "stays latched" in call(tmp_path, "reset", typed="n\n").output
    refused(tmp_path, "home", *LIMIT)
    assert "nobody to answer" in refused(tmp_path, "reset", typed="")
    assert "No such option" in call(tmp_path, "reset", "--yes").output
    assert "9 N, of 3 N allowed" in call(tmp_path, "reset", typed="y\n").output
    assert "not latched" in call(tmp_path, "reset").output
    call(tmp_path, "home", *LIMIT)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("home",), "Missing option '--limit'"),
        (("home", "--limit", "5 um"), "--limit 5 um"),
        (("home", "--limit", "0 N"), "greater than 0"),
        (("home", "--limit", "18 N"), "the sensor tells 18000 mN at most"),
        (("home", *LIMIT, "--axis", "u"), "no axis `u`"),
        (("identify", "--touch", "x", "--until", "400 mN", *LIMIT), "too near to the limit"),
    ],
)
def test_what_cannot_be_is_refused_before_anything_moves(
    tmp_path: Path, emulated: EmulatedRig, arguments: tuple[str, ...], words: str
) -> None:
    call(tmp_path, "check")
    before = emulated.positions()
    try:
        told = call(tmp_path, *arguments).output
    except NeuroroboError as error:
        told = str(error)
    assert words in told
    assert emulated.positions() == before


def test_a_speed_is_that_of_the_middle_of_a_move() -> None:
    """Of a move that speeds up at 5 mm/s^2 to 1 mm/s and slows down again, looked at every 20 ms."""
    times = np.arange(0, 2.2, 0.02)
    ramp = np.minimum(times, 0.2)
    ways = (
        2500 * ramp**2
        + 1000 * np.clip(times - 0.2, 0, 1.8)
        + np.where(times > 2.0, 1000 * (times - 2.0) - 2500 * (times - 2.0) ** 2, 0)
    )
    track = [(round(at * 1e9), float(way)) for at, way in zip(times, ways, strict=True)]
    assert _speed_um_s(track) == pytest.approx(1000, rel=1e-6)


def test_slopes_and_their_errors_are_those_of_least_squares() -> None:
    generator = np.random.default_rng(1000)
    x = np.array([0.0, 2, 0, -2] * 5)
    y = np.stack([3 * x + generator.standard_normal(20), -x], axis=1)
    slopes, errors = _lines(x, y)
    expected = statistics.linear_regression(x.tolist(), y[:, 0].tolist())
    assert slopes == pytest.approx([expected.slope, -1.0])
    _, covariance = np.polyfit(x, y[:, 0], 1, cov=True)
    assert errors == pytest.approx([covariance[0, 0] ** 0.5, 0.0])


def test_what_no_component_follows_any_more_is_not_believed_from_before(tmp_path: Path, emulated: EmulatedRig) -> None:
    call(tmp_path, "check")
    call(tmp_path, "home", *LIMIT)
    assert "x: Fy follows it" in call(tmp_path, "identify", *TOUCH, "--amplitude", "15um").output
    told = call(tmp_path, "identify", *TOUCH, "--amplitude", "0.1um").output
    assert "x: no component follows it" in told
    identified = Commissioning(tmp_path / "rig.yaml", registry()).record.identify
    assert identified is not None
    assert not identified.responses


def test_a_load_that_is_there_already_is_no_contact(tmp_path: Path) -> None:
    near = {"physics": {**WALL["physics"], "at": "-100 um"}}
    with EmulatedRig(loaded(tmp_path, rig("pi_gcs", emulate=near))) as running:
        written(tmp_path, running.config.dump())
        call(tmp_path, "check")
        call(tmp_path, "home", *LIMIT)
        call(tmp_path, "identify", "--axis", "y")
        assert "x: the load is 200 mN before it is moved" in refused(tmp_path, "calibrate", *TOUCH)
    assert not (tmp_path / "rig.calibrated.yaml").exists()


def test_a_rig_that_cannot_be_stopped_at_ctrl_c_is_told_of(tmp_path: Path) -> None:
    mock = {"type": "stages.mock_force_sensor", "bias_readings": 1}
    with EmulatedRig(loaded(tmp_path, rig("mock_stage", force_sensor={**SENSOR, **mock}))) as emulated:
        commissioning = Commissioning(written(tmp_path, emulated.config.dump()), registry())
        commissioning.config = emulated.config
        commissioning.record.check = Check(
            answers_after_ms={}, sensor_rate_Hz=1000, sensor_gap_ms=50, offset={}, noise={}
        )
        said: list[str] = []
        dialogue = Dialogue(said.append, lambda _: True, lambda _: "")
        with pytest.raises(KeyboardInterrupt), Moves(commissioning, dialogue, 500.0):
            emulated.controllers["controller_0"].emulator.unplugged = True
            raise KeyboardInterrupt
    assert "cut its power: controller_0: " in said[-1]
    assert "controller_0: controller_0" not in said[-1]


def test_a_rig_that_was_stopped_by_ctrl_c_is_said_to_stand(tmp_path: Path, emulated: EmulatedRig) -> None:
    call(tmp_path, "check")
    commissioning = Commissioning(tmp_path / "rig.yaml", registry())
    said: list[str] = []
    dialogue = Dialogue(said.append, lambda _: True, lambda _: "")
    with pytest.raises(KeyboardInterrupt), Moves(commissioning, dialogue, 500.0):
        raise KeyboardInterrupt
    assert said[-1].startswith("all axes were sent a stop within ")


def test_a_latch_holds_for_every_file_of_the_rig(tmp_path: Path, emulated: EmulatedRig) -> None:
    """A calibration writes another file of the same rig: what has latched the one must not move by the other."""
    call(tmp_path, "check")
    calibrated = tmp_path / "rig.calibrated.yaml"
    calibrated.write_text((tmp_path / "rig.yaml").read_text())
    Commissioning(calibrated, registry()).latch.set(Trip("force", "9 N, of 3 N allowed", "look at it", "latch"))
    assert "it is latched" in refused(tmp_path, "home", *LIMIT)
