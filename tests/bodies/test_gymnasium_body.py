"""Any Gymnasium environment as a body: what it does is what the environment does by itself."""

import itertools
import sys
from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box, Dict, Discrete, MultiDiscrete, Sequence, Space
from pydantic import ValidationError

from neurorobo.bodies import Actuator, Sensor
from neurorobo.bodies.gymnasium_body import GymnasiumBody
from neurorobo.bodies.gymnasium_body_config import GymnasiumBodyConfig
from neurorobo.errors import NeuroroboError
from neurorobo.testing import check_body

PERIOD_NS = 50_000_000
PENDULUM = {
    "environment": "Pendulum-v1",
    "sensors": {"direction": {"elements": [0, 1]}, "velocity": {"elements": [2], "unit": "rad/s"}},
    "actuators": {"torque": {"unit": "N*m"}},
}


NUMBERS = itertools.count()


class Toy(gymnasium.Env[Any, Any]):
    """Observes the last action, and of what kind it was."""

    def __init__(self, action: Space[Any], observation: Space[Any] | None = None) -> None:
        self.action_space = action
        self.observation_space = observation or Dict({"kind": Discrete(3), "echo": Box(-9.0, 9.0, (2, 2), np.float64)})

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        return {"kind": 0, "echo": np.zeros((2, 2))}, {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        assert self.action_space.contains(action)
        return {"kind": 2, "echo": np.broadcast_to(action, (2, 2))}, 1.0, False, False, {}


@pytest.fixture
def toy() -> Any:
    """Register a toy of these spaces, for the length of a test; of a fresh name each, as spaces are remembered."""
    made: list[str] = []

    def register(*spaces: Space[Any]) -> str:
        name = f"neurorobo_tests/Toy{next(NUMBERS)}-v0"
        gymnasium.register(name, entry_point=lambda: Toy(*spaces), order_enforce=False)
        made.append(name)
        return name

    yield register
    for name in made:
        del gymnasium.registry[name]


def config(**options: Any) -> GymnasiumBodyConfig:
    return GymnasiumBodyConfig.model_validate({"type": "gymnasium_environment", **options})


def fault(**options: Any) -> str:
    with pytest.raises(ValidationError) as error:
        config(**options)
    (only,) = error.value.errors()
    return only["msg"]


def test_it_keeps_the_contract_of_bodies() -> None:
    check_body(config(**PENDULUM), period_ns=PERIOD_NS)
    check_body(config(environment="MountainCar-v0"))


def test_it_observes_and_gains_what_the_environment_gives_by_itself_until_it_ends() -> None:
    body, alone = GymnasiumBody(config(**PENDULUM, kwargs={"max_episode_steps": 30})), gymnasium.make("Pendulum-v1")
    body.reset([5, 6])
    expected, _ = alone.reset(seed=6)
    torques = np.random.default_rng(0).uniform(-2, 2, (30, 2, 1))
    for tick in range(30):
        assert not body.truncated.any()
        seen = body.read()
        assert np.concatenate([seen["direction"], seen["velocity"]], axis=1)[1].tolist() == expected.tolist()
        body.advance({"torque": torques[tick]}, PERIOD_NS)
        expected, reward, _, _, _ = alone.step(torques[tick, 1].astype(np.float32))
        assert body.reward[1] == reward
    assert body.truncated.all()
    assert not body.terminated.any()
    last = body.read()["direction"]
    body.advance({"torque": torques[0]}, PERIOD_NS)  # an episode that has ended stands still, and gains nothing
    assert np.array_equal(body.read()["direction"], last)
    assert not body.reward.any()


def test_by_default_there_is_one_sensor_and_one_actuator_of_all_elements() -> None:
    whole = config(environment="Pendulum-v1")
    assert whole.sensors() == {"observation": Sensor("1", 3, -8.0, 8.0)}
    assert whole.actuators() == {"action": Actuator("1", 1, -2.0, 2.0)}


def test_named_sensors_have_the_bounds_of_their_elements() -> None:
    assert config(**PENDULUM).sensors() == {
        "direction": Sensor("1", 2, -1.0, 1.0),
        "velocity": Sensor("rad/s", 1, -8.0, 8.0),
    }


def test_a_sensor_saturates_at_its_range() -> None:
    body = GymnasiumBody(config(environment="Pendulum-v1", sensors={"sine": {"elements": [1], "range": "-0.1..0.1"}}))
    body.reset(range(8))
    whole = GymnasiumBody(config(environment="Pendulum-v1"))
    whole.reset(range(8))
    assert np.array_equal(body.read()["sine"], np.clip(whole.read()["observation"][:, 1:2], -0.1, 0.1))


def test_of_discrete_actions_the_most_preferred_is_taken() -> None:
    body, alone = GymnasiumBody(config(environment="MountainCar-v0")), gymnasium.make("MountainCar-v0")
    body.reset([3, 3])
    alone.reset(seed=3)
    body.advance({"action": np.array([[0.1, -5.0, 0.3], [0.5, 0.2, 0.3]])}, PERIOD_NS)
    pushed_right, *_ = alone.step(2)
    assert body.read()["observation"][0].tolist() == pushed_right.tolist()
    assert body.read()["observation"][1, 1] < pushed_right[1]


def test_what_is_no_vector_is_flattened_and_actions_get_their_shape(toy: Callable[..., str]) -> None:
    space = Box(np.array([[-1.0, -2.0]]), np.array([[1.0, 2.0]]), dtype=np.float64)
    body = GymnasiumBody(
        config(environment=toy(space), actuators={"right": {"elements": [1]}, "left": {"elements": [0]}})
    )
    body.reset([0])
    assert body.actuators["right"] == Actuator("1", 1, -2.0, 2.0)
    body.advance({"right": np.array([[1.5]]), "left": np.array([[-0.5]])}, 1)
    assert body.read()["observation"].tolist() == [[-0.5, 1.5, -0.5, 1.5, 0.0, 0.0, 1.0]]
    body.advance({"left": np.array([[0.25]])}, 1)  # what is not commanded anew stays
    assert body.read()["observation"][0, :2].tolist() == [0.25, 1.5]


def test_other_spaces_are_refused_by_name(toy: Callable[..., str]) -> None:
    message = fault(environment=toy(MultiDiscrete([2, 3])))
    assert "takes actions of MultiDiscrete([2 3]); only Box and Discrete" in message
    message = fault(environment=toy(Discrete(2), Sequence(Discrete(2))))
    assert "observes Sequence(Discrete(2), stack=False), which has no fixed number of elements" in message


def test_a_period_that_is_not_the_environments_is_refused() -> None:
    body = GymnasiumBody(config(**PENDULUM))
    body.reset([0])
    with pytest.raises(NeuroroboError, match=r"takes 50 ms, not 100 ms; write `time: \{control: 50 ms"):
        body.advance({}, 2 * PERIOD_NS)


def test_elements_without_bounds_are_named() -> None:
    message = fault(environment="CartPole-v1")
    assert "`sensors.observation`: elements 1, 3" in message
    assert "give the sensor a `range`" in message
    whole = config(environment="CartPole-v1", sensors={"state": {"range": "-5..5"}})
    assert whole.sensors() == {"state": Sensor("1", 4, -5.0, 5.0)}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"environment": "Pendulam-v1"}, "Did you mean: `Pendulum`"),
        ({"environment": "Pendulum-v1", "kwargs": {"gravity": 1}}, "gravity"),
        ({"environment": "nowhere:Pendulum-v1"}, "install the package that provides it"),
        ({"environment": "Pendulum-v1", "sensors": {"a": {"elements": [3]}}}, "there are no elements 3; they count"),
        ({"environment": "Pendulum-v1", "sensors": {"a": {"range": "0..1 N"}}}, "'0 N' is a force"),
        ({"environment": "Pendulum-v1", "sensors": {"a": {"unit": "florps"}}}, "'florps' is not a unit"),
        ({"environment": "Pendulum-v1", "actuators": {"a": {}, "b": {}}}, "elements 0 of the action must each belong"),
    ],
)
def test_what_does_not_fit_is_said(options: dict[str, Any], message: str) -> None:
    assert message in fault(**options)


def test_a_missing_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.startswith("gymnasium.envs.mujoco")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "glfw", None)
    message = fault(environment="InvertedPendulum-v5", sensors={"state": {"range": "-9..9"}})
    assert "pip install 'neurorobo[mujoco]'" in message


@pytest.mark.skipif(any(find_spec(name) is None for name in ("mujoco", "glfw", "imageio")), reason="needs `mujoco`")
def test_environments_of_mujoco_are_bodies() -> None:
    sensors = {"position": {"elements": [0, 1], "range": "-3..3"}, "velocity": {"elements": [2, 3], "range": "-9..9"}}
    check_body(config(environment="InvertedPendulum-v5", sensors=sensors), period_ns=40_000_000)
