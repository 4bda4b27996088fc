"""The conformance kit passes bodies that keep the contract, and catches what breaks it, by name."""

from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
from typing import Any, ClassVar

import numpy as np
import pytest
from numpy.typing import NDArray
from precision_interaction.rig.insertion_rig_config import InsertionRigConfig
from precision_interaction.rig.mujoco_rig_config import MujocoRigConfig

from neurorobo.bodies import Actuator, Array, BodyConfig, Sensor
from neurorobo.testing import ConformanceError, check_body
from tests.tasks.toys import Cart, CartConfig


@pytest.mark.parametrize("config", [CartConfig(), InsertionRigConfig()], ids=lambda config: config.type)
def test_bodies_that_keep_the_contract_pass(config: BodyConfig) -> None:
    check_body(config)
    check_body(config, period_ns=200_000_000, motions=7, batch=5)


@pytest.mark.skipif(find_spec("mujoco") is None, reason="the extra `mujoco` is not installed")
def test_a_body_that_another_engine_simulates_passes() -> None:
    check_body(MujocoRigConfig.model_validate({"gap": "10 um", "max_radial_move": "1 um"}), motions=3)


class Forgetful(Cart):
    def reset(self, seeds: Sequence[int], which: NDArray[np.bool_] | None = None) -> None:
        super().reset(seeds, which)
        if which is None:
            self.worn = np.zeros((len(seeds), 1))

    def advance(self, commands: Mapping[str, Array], duration_ns: int) -> None:
        self.worn = self.worn + 0.1
        super().advance(commands, duration_ns)
        self.position = self.position + self.worn


class Careless(Cart):
    def reset(self, seeds: Sequence[int], which: NDArray[np.bool_] | None = None) -> None:
        super().reset(seeds, which)
        if which is not None:
            self.position = self.position * np.where(which, 1.0, 0.5)[:, None]


class Sociable(Cart):
    def advance(self, commands: Mapping[str, Array], duration_ns: int) -> None:
        super().advance(commands, duration_ns)
        self.position = self.position + self.position.mean(axis=0)


class Unseeded(Cart):
    def advance(self, commands: Mapping[str, Array], duration_ns: int) -> None:
        super().advance(commands, duration_ns)
        self.position = self.position + np.random.default_rng().standard_normal(self.position.shape)


class Restless(Cart):
    def read(self) -> dict[str, Array]:
        self.position = self.position + 0.01
        return super().read()


class Grasping(Cart):
    def advance(self, commands: Mapping[str, Array], duration_ns: int) -> None:
        super().advance(commands, duration_ns)
        commands["nudge"][:] = 0.0


class Flat(Cart):
    def read(self) -> dict[str, Array]:
        return {name: values[:, 0] for name, values in super().read().items()}


class Silent(Cart):
    def read(self) -> dict[str, Array]:
        return {"force": super().read()["force"]}


class Overflowing(Cart):
    def read(self) -> dict[str, Array]:
        return {name: values + 1000.0 for name, values in super().read().items()}


class Inverted(Cart):
    def limits(self, duration_ns: int) -> dict[str, tuple[Array, Array]]:
        return {name: (hi, lo) for name, (lo, hi) in super().limits(duration_ns).items()}


class Wide(Cart):
    def limits(self, duration_ns: int) -> dict[str, tuple[Array, Array]]:
        return {name: (np.zeros((7, 7)), hi) for name, (_, hi) in super().limits(duration_ns).items()}


BROKEN: dict[type[Cart], str] = {
    Forgetful: "after a partial reset than at a fresh start",
    Careless: "as another body started again",
    Sociable: "alone than in a batch",
    Unseeded: "with the same seed",
    Restless: "the second time",
    Grasping: "changes the command `nudge`",
    Flat: "the sensor `force` reads (3,), not (3, 2)",
    Silent: "it reads force, but declares force, position",
    Overflowing: "out of its range -5.0..5.0",
    Inverted: "the least command of `speed` is above the largest",
    Wide: "the limits of `speed` do not fit commands of the shape (3, 1)",
}


@pytest.mark.parametrize("body", BROKEN, ids=lambda body: body.__name__)
def test_a_broken_body_is_caught_by_name(body: type[Cart]) -> None:
    class Config(CartConfig):
        implementation: ClassVar[str] = f"{__name__}:{body.__name__}"

    with pytest.raises(ConformanceError) as caught:
        check_body(Config())
    assert str(caught.value).startswith("`toy.cart`: ")
    assert BROKEN[body] in str(caught.value)


@pytest.mark.parametrize(
    ("sensor", "fault"),
    [
        (lambda: {"a b": Sensor("mN")}, "cannot be referred to"),
        (lambda: {"force": Sensor("mN", 0)}, "has no room"),
        (lambda: {"force": Sensor("mN", 1, 2.0, 2.0)}, "has no room"),
        (lambda: {"force": Sensor("pushes")}, "use a unit such as"),
        (iter([{"a": Sensor("mN")}, {"b": Sensor("mN")}]).__next__, "differ from call to call"),
    ],
)
def test_channels_that_make_no_sense_are_caught(sensor: Callable[[], dict[str, Any]], fault: str) -> None:
    class Config(CartConfig):
        def sensors(self) -> dict[str, Sensor]:
            return sensor()

        def actuators(self) -> dict[str, Actuator]:
            return {}

    with pytest.raises(ConformanceError, match=fault):
        check_body(Config())
