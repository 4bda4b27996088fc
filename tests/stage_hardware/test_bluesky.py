"""Axes as Bluesky takes them: the protocols by their structure, and by Bluesky itself where it is installed."""

import threading
import time
from collections.abc import Iterator
from fractions import Fraction
from typing import Any

import pytest
from stage_hardware.bluesky import BlueskyAxis, MotionStatus, bluesky_axes
from stage_hardware.drivers.shot import ShotStage
from stage_hardware.drivers.sigma_koki import SigmaKokiAxis
from stage_hardware.emulators.mock_stage import MockStage
from stage_hardware.emulators.shot import ShotEmulator
from stage_hardware.emulators.sigma_koki import Speeds
from stage_hardware.errors import HardwareError, LinkError
from stage_hardware.stage import Axis, Stage

TABLE = Axis("um", -5000, 5000, 1, speed=20_000, acceleration=200_000)


def homed(stage: Stage) -> Stage:
    stage.home(list(stage.axes))
    while any(axis.moving for axis in stage.state().axes.values()):
        time.sleep(0.005)
    return stage


@pytest.fixture
def mock() -> MockStage:
    stage = MockStage("m", {"x": TABLE, "y": TABLE}, positions={"x": 20, "y": 20})
    stage.connect()
    homed(stage)
    return stage


@pytest.fixture
def wired() -> Iterator[Stage]:
    """A stage whose axes cannot move at the same time."""
    axes = {"x": SigmaKokiAxis(TABLE, 1, Fraction(1)), "y": SigmaKokiAxis(TABLE, 2, Fraction(1))}
    with ShotEmulator(baud=0, processing_s=0) as emulator, ShotStage("m", emulator.url, axes, timeout_s=2.0) as stage:
        emulator.origin_speeds = Speeds(5000, 20_000, 10)
        yield homed(stage)


@pytest.fixture(params=["mock", "wired"])
def axes(request: pytest.FixtureRequest) -> dict[str, BlueskyAxis]:
    return bluesky_axes(request.getfixturevalue(request.param), poll_s=0.005)


def test_a_motion_is_set_waited_for_and_read(axes: dict[str, BlueskyAxis]) -> None:
    x = axes["x"]
    assert (x.name, x.parent, x.hints) == ("m_x", None, {"fields": ["m_x"]})
    heard: list[MotionStatus] = []
    status = x.set(400)
    status.add_callback(heard.append)
    status.wait(5)
    assert status.done and status.success and status.exception() is None
    status.add_callback(heard.append)  # as it has ended, at once
    assert heard == [status, status]
    reading = x.read()["m_x"]
    assert reading["value"] == x.position == 400 and abs(reading["timestamp"] - time.time()) < 5
    assert x.locate() == {"setpoint": 400, "readback": 400}


def test_what_it_tells_of_itself_belongs_together(mock: MockStage) -> None:
    x = BlueskyAxis(mock, "x")
    assert x.read().keys() == x.describe().keys()
    assert x.read_configuration().keys() == x.describe_configuration().keys()
    assert x.describe()["m_x"]["units"] == "um" and x.describe()["m_x"]["dtype"] == "number"
    assert {key: told["value"] for key, told in x.read_configuration().items()} == {
        "m_x_resolution": 1,
        "m_x_speed": 20_000,
        "m_x_acceleration": 200_000,
    }


def test_axes_move_together_or_in_turns(axes: dict[str, BlueskyAxis]) -> None:
    statuses = [axis.set(300) for axis in axes.values()]
    for status in statuses:
        status.wait(5)
    assert [axis.position for axis in axes.values()] == [300, 300]


def test_a_stop_ends_all_motions_that_are_under_way_or_wait(axes: dict[str, BlueskyAxis]) -> None:
    for success in (False, True):
        statuses = [axis.set(4900) for axis in axes.values()]
        time.sleep(0.08)
        axes["x"].stop(success=success)
        for status in statuses:
            error = status.exception(5)
            assert status.success is success
            assert error is None if success else isinstance(error, HardwareError)
        assert all(axis.position < 4900 for axis in axes.values())
        assert not any(axis.moving for axis in axes["x"].stage.state().axes.values())
        for axis in axes.values():
            axis.set(0).wait(5)


def test_a_stop_that_comes_just_before_the_motion_ends_it(mock: MockStage) -> None:
    x = BlueskyAxis(mock, "x", poll_s=0.005)
    begin = mock.move_to

    def stopped_meanwhile(targets: Any) -> None:
        x.stop()
        begin(targets)

    mock.move_to = stopped_meanwhile
    error = x.set(4900).exception(5)
    assert isinstance(error, HardwareError) and mock.state().axes["x"].position < 500


def test_what_goes_wrong_ends_the_status_with_it(mock: MockStage) -> None:
    x = BlueskyAxis(mock, "x", poll_s=0.005)
    with pytest.raises(HardwareError, match="would go to 6000 um"):
        x.set(6000).wait(5)
    mock.mechanisms["x"].upper_switch = 100
    with pytest.raises(HardwareError, match=r"came to rest at 100 um, not 400 \(axis x ran onto a limit switch\)"):
        x.set(400).wait(5)
    status = x.set(-4000)
    mock.unplugged = True
    with pytest.raises(LinkError):
        status.wait(5)
    assert status.done and not status.success


def test_a_motion_that_takes_too_long_is_stopped(mock: MockStage, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("stage_hardware.bluesky.MARGIN_S", 0.0)
    mock.mechanisms["x"].slowness = 100
    error = BlueskyAxis(mock, "x", poll_s=0.005).set(1000).exception(10)
    assert isinstance(error, TimeoutError) and "still moves at" in str(error)
    assert not mock.state().axes["x"].moving


def test_a_status_that_has_not_ended_says_so() -> None:
    with pytest.raises(TimeoutError, match=r"has not ended within 0\.01 s"):
        MotionStatus().wait(0.01)


def test_bluesky_scans_reads_and_moves(axes: dict[str, BlueskyAxis]) -> None:
    run_engine = pytest.importorskip("bluesky.run_engine")
    protocols = pytest.importorskip("bluesky.protocols")
    from bluesky import plan_stubs, plans

    for protocol in ("Movable", "Readable", "Stoppable", "Configurable", "Locatable", "HasHints", "HasParent"):
        assert isinstance(axes["x"], getattr(protocols, protocol)), protocol
    assert isinstance(MotionStatus(), protocols.Status)
    documents: list[tuple[str, dict[str, Any]]] = []
    engine = run_engine.RunEngine(context_managers=[])
    x, y = axes["x"], axes["y"]
    engine(plan_stubs.mv(x, 100, y, -100))
    assert (x.position, y.position) == (100, -100)
    engine(plan_stubs.mvr(x, 20))
    assert x.position == 120
    engine(plans.scan([x, y], x, -200, 200, y, 0, 400, 5), lambda name, document: documents.append((name, document)))
    events = [document["data"] for name, document in documents if name == "event"]
    assert [(event["m_x"], event["m_y"]) for event in events] == [
        (-200, 0),
        (-100, 100),
        (0, 200),
        (100, 300),
        (200, 400),
    ]
    descriptor = next(document for name, document in documents if name == "descriptor")
    assert descriptor["data_keys"]["m_x"]["units"] == "um"
    assert descriptor["configuration"]["m_x"]["data"]["m_x_speed"] == 20_000


def test_bluesky_hears_of_failures_and_stops_motions(axes: dict[str, BlueskyAxis]) -> None:
    run_engine = pytest.importorskip("bluesky.run_engine")
    utils = pytest.importorskip("bluesky.utils")
    from bluesky import plan_stubs

    engine, x = run_engine.RunEngine(context_managers=[]), axes["x"]
    with pytest.raises(utils.FailedStatus) as failed:
        engine(plan_stubs.mv(x, 1e6))
    assert "stay within -5000..5000 um" in str(failed.value.__cause__)

    def abandoned() -> Iterator[Any]:
        yield from plan_stubs.abs_set(x, 4900, group="far")
        yield from plan_stubs.sleep(0.05)
        raise ValueError("the plan is at its end")

    with pytest.raises(ValueError, match="at its end"):
        engine(abandoned())
    time.sleep(0.1)
    assert not x.stage.state().axes["x"].moving and x.position < 4900
    assert threading.active_count() < 20
