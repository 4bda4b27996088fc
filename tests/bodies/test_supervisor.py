"""No command leaves its limits, and every change of one is counted."""

from collections.abc import Mapping

import numpy as np
import pytest

from neurorobo.bodies import Array, Supervisor
from neurorobo.errors import NeuroroboError
from tests.tasks.toys import Cart, CartConfig

SECOND = 1_000_000_000


class NearTheEnd(Cart):
    """May only roll on as far as 2.5 um, which each cart reaches in its own time; remembers its commands."""

    def limits(self, duration_ns: int) -> dict[str, tuple[Array, Array]]:
        left = (2.5 - self.position[:, :1]) / (duration_ns * 1e-9)
        return {**super().limits(duration_ns), "speed": (np.zeros_like(left), np.minimum(left, 1.0))}

    def advance(self, commands: Mapping[str, Array], duration_ns: int) -> None:
        self.given = {**commands}
        super().advance(commands, duration_ns)


@pytest.fixture
def body() -> NearTheEnd:
    body = NearTheEnd(CartConfig(noise=0.0))
    body.reset([1, 2, 3])
    return body


@pytest.fixture
def supervisor(body: NearTheEnd) -> Supervisor:
    supervisor = Supervisor(body)
    supervisor.reset(3)
    return supervisor


def advance(
    supervisor: Supervisor,
    speed: list[float],
    nudge: list[list[float]] | None = None,
    running: tuple[int, ...] = (1, 1, 1),
) -> dict[str, Array]:
    commands = {"speed": np.array(speed)[:, None]}
    if nudge is not None:
        commands["nudge"] = np.array(nudge)
    return supervisor.advance(commands, SECOND, np.array(running, dtype=np.bool_))


def test_commands_are_clamped_to_what_is_declared_and_the_body_gets_them(
    body: NearTheEnd, supervisor: Supervisor
) -> None:
    given = advance(supervisor, [0.5, 7.0, -7.0], [[0.0, 0.0], [2.0, -3.0], [0.5, 0.5]])
    assert given["speed"].tolist() == [[0.5], [1.0], [0.0]]
    assert given["nudge"].tolist() == [[0.0, 0.0], [1.0, -1.0], [0.5, 0.5]]
    assert {name: values.tolist() for name, values in body.given.items()} == {
        name: values.tolist() for name, values in given.items()
    }


def test_the_limits_are_those_of_the_moment_and_of_each_body(body: NearTheEnd, supervisor: Supervisor) -> None:
    for _ in range(3):
        given = advance(supervisor, [1.0, 0.5, 1.0])
    assert given["speed"].tolist() == [[0.5], [0.5], [0.5]]
    assert body.position[:, 0].tolist() == [2.5, 1.5, 2.5]
    assert supervisor.interventions.tolist() == [1, 0, 1]


def test_an_intervention_counts_once_per_period_and_actuator_however_many_components_it_changes(
    supervisor: Supervisor,
) -> None:
    advance(supervisor, [0.1, 0.1, 9.0], [[0.0, 0.0], [9.0, 9.0], [9.0, 0.0]])
    assert supervisor.interventions.tolist() == [0, 1, 2]
    advance(supervisor, [9.0, 0.1, 0.1])
    assert supervisor.interventions.tolist() == [1, 1, 2]
    supervisor.reset(3)
    assert supervisor.interventions.tolist() == [0, 0, 0]


def test_interventions_are_counted_by_actuator_and_those_of_the_latest_call_shown(supervisor: Supervisor) -> None:
    advance(supervisor, [0.1, 0.1, 9.0], [[0.0, 0.0], [9.0, 9.0], [9.0, 0.0]])
    advance(supervisor, [9.0, 0.1, 0.1])
    assert {name: count.tolist() for name, count in supervisor.latest.items()} == {
        "speed": [1, 0, 0],
        "nudge": [0, 0, 0],
    }
    assert {name: count.tolist() for name, count in supervisor.counts.items()} == {
        "speed": [1, 0, 1],
        "nudge": [0, 1, 1],
    }
    supervisor.reset(3, np.array([False, False, True]))
    assert supervisor.interventions.tolist() == [1, 1, 0]


def test_an_intervention_counts_only_where_an_episode_is_running(supervisor: Supervisor) -> None:
    given = advance(supervisor, [9.0, 9.0, 9.0], running=(1, 0, 1))
    assert given["speed"].tolist() == [[1.0]] * 3
    assert supervisor.interventions.tolist() == [1, 0, 1]


def test_rounding_is_no_intervention(supervisor: Supervisor) -> None:
    advance(supervisor, [1.0 + 1e-7, 0.1, 0.1])
    assert supervisor.interventions.tolist() == [0, 0, 0]


@pytest.mark.parametrize("broken", [float("nan"), float("inf"), -float("inf")])
def test_a_command_that_is_no_number_stops_the_body_and_says_which(
    body: NearTheEnd, supervisor: Supervisor, broken: float
) -> None:
    advance(supervisor, [0.5, 0.5, 0.5])
    before = body.position.copy()
    with pytest.raises(NeuroroboError, match=rf"the command `nudge` is {broken}: the body was stopped"):
        advance(supervisor, [0.5, 0.5, 0.5], [[0.0, 0.0], [0.0, broken], [0.0, 0.0]])
    assert body.stopped == 1
    assert body.speed.tolist() == [[0.0]] * 3
    assert np.array_equal(body.position, before)


def test_what_is_not_commanded_goes_on_as_it_was(body: NearTheEnd, supervisor: Supervisor) -> None:
    advance(supervisor, [0.5, 0.5, 0.5])
    supervisor.advance({}, SECOND, np.ones(3, dtype=np.bool_))
    assert body.position[:, 0].tolist() == [1.0, 1.0, 1.0]


def test_by_default_a_body_may_be_given_what_its_actuators_declare() -> None:
    limits = Cart(CartConfig()).limits(SECOND)
    assert {name: (lo.tolist(), hi.tolist()) for name, (lo, hi) in limits.items()} == {
        "speed": ([-1.0], [1.0]),
        "nudge": ([-1.0, -1.0], [1.0, 1.0]),
    }


def test_a_held_command_is_clamped_anew_at_every_call_and_an_increment_is_given_once(
    body: NearTheEnd, supervisor: Supervisor
) -> None:
    advance(supervisor, [1.0, 0.5, 1.0], [[0.0, 0.1]] * 3)
    speeds = []
    for _ in range(3):
        given = supervisor.advance({}, SECOND, np.ones(3, dtype=np.bool_))
        assert set(given) == set(body.given) == {"speed"}
        speeds.append(given["speed"][:, 0].tolist())
    assert speeds == [[1.0, 0.5, 1.0], [0.5, 0.5, 0.5], [0.0, 0.5, 0.0]]
    assert body.position[:, 0].tolist() == [2.5, 2.0, 2.5]
    assert body.position[:, 1].tolist() == [0.1] * 3


def test_a_held_command_counts_only_when_it_has_to_be_changed_further(supervisor: Supervisor) -> None:
    counts = []
    advance(supervisor, [9.0, 0.5, 0.5])
    for _ in range(3):
        counts.append(supervisor.interventions.tolist())
        supervisor.advance({}, SECOND, np.ones(3, dtype=np.bool_))
    assert counts == [[1, 0, 0], [1, 0, 0], [2, 0, 0]]  # clamped to 1.0, again to 1.0, then to 0.5


def test_a_body_that_starts_again_is_not_given_its_old_command(body: NearTheEnd, supervisor: Supervisor) -> None:
    advance(supervisor, [9.0, 9.0, 0.5])
    again = np.array([True, False, False])
    body.reset([4], again)
    supervisor.reset(3, again)
    assert supervisor.interventions.tolist() == [0, 1, 0]
    assert supervisor.advance({}, SECOND, np.ones(3, dtype=np.bool_)) == {}
    assert body.position[:, 0].tolist() == [0.0, 2.0, 1.0]
