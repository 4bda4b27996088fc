"""A cart on a noisy rail and the task of reaching its end: results can be computed by hand where the noise is off."""

from collections.abc import Mapping, Sequence
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from neurorobo.bodies import Actuator, Array, Body, BodyConfig, Sensor
from neurorobo.tasks.task import Flags, Task, TaskConfig


class CartConfig(BodyConfig):
    """A cart that moves along x at a speed and can be nudged in the plane."""

    implementation: ClassVar[str] = "tests.tasks.toys:Cart"
    type: Literal["toy.cart"] = "toy.cart"
    noise: float = 0.05

    def sensors(self) -> dict[str, Sensor]:
        return {"force": Sensor("mN", 2, -5.0, 5.0), "position": Sensor("um", 2, -100.0, 100.0)}

    def actuators(self) -> dict[str, Actuator]:
        return {"speed": Actuator("um/s", 1, -1.0, 1.0), "nudge": Actuator("um", 2, -1.0, 1.0, kind="increment")}


class Cart(Body):
    """Each cart rolls with a noise of its own; the force it feels grows with y."""

    def __init__(self, config: CartConfig) -> None:
        super().__init__(config)
        self.noise = config.noise
        self.stopped = 0
        self.reset([])

    def reset(self, seeds: Sequence[int], which: NDArray[np.bool_] | None = None) -> None:
        if which is None:
            which = np.ones(len(seeds), dtype=np.bool_)
            self.generators = [np.random.default_rng(0)] * len(seeds)
            self.position, self.speed = np.zeros((len(seeds), 2)), np.zeros((len(seeds), 1))
        for i, seed in zip(np.flatnonzero(which), seeds, strict=True):
            self.generators[i] = np.random.default_rng(seed)
            self.position[i] = self.noise * self.generators[i].standard_normal(2)
        self.speed[which] = 0.0

    def read(self) -> dict[str, Array]:
        return {"force": np.clip(self.position[:, ::-1] * [2.0, 0.0], -5, 5), "position": self.position}

    def advance(self, commands: Mapping[str, Array], duration_ns: int) -> None:
        self.speed = commands.get("speed", self.speed)
        noise = np.array([generator.standard_normal(2) for generator in self.generators]).reshape(-1, 2)
        self.position = self.position + self.noise * noise + commands.get("nudge", 0.0)
        self.position[:, 0] += self.speed[:, 0] * duration_ns * 1e-9

    def stop(self) -> None:
        self.stopped += 1
        self.speed = np.zeros_like(self.speed)


class ReachConfig(TaskConfig):
    """Reach the goal within the time."""

    implementation: ClassVar[str] = "tests.tasks.toys:Reach"
    type: Literal["toy.reach"] = "toy.reach"
    goal_um: float = 3.0
    time_limit_ns: int = 8_000_000_000


class Reach(Task[Cart]):
    """Keeps its results in arrays of its own and returns these, as a task may."""

    def __init__(self, config: ReachConfig, body: Cart) -> None:
        super().__init__(config, body)
        self.config = config
        self.reset(0)

    def reset(self, batch: int, which: Flags | None = None) -> None:
        if which is None:
            which = np.ones(batch, dtype=np.bool_)
            self.elapsed_ns, self.value = np.zeros(batch, dtype=np.int64), np.zeros(batch)
            self.reached, self.late = np.zeros((2, batch), dtype=np.bool_)
        self.elapsed_ns[which] = 0
        self.value[which] = 0.0
        self.reached[which] = self.late[which] = False

    def observe(self, duration_ns: int, running: Flags) -> None:
        self.elapsed_ns[running] += duration_ns
        x = self.body.position[:, 0]
        self.value[running] = x[running] - self.config.goal_um
        self.reached[running] = self.value[running] >= 0
        self.late[running] = ~self.reached[running] & (self.elapsed_ns[running] >= self.config.time_limit_ns)

    def reward(self) -> Array:
        return self.value

    def terminated(self) -> Flags:
        return self.reached

    def truncated(self) -> Flags:
        return self.late

    def metrics(self) -> Sequence[dict[str, float]]:
        return [
            {"duration_s": float(elapsed) * 1e-9, "success": float(reached), "error_um": abs(float(value))}
            for elapsed, reached, value in zip(self.elapsed_ns, self.reached, self.value, strict=True)
        ]


def reach(noise: float = 0.05) -> Reach:
    """A cart and its task."""
    return Reach(ReachConfig(), Cart(CartConfig(noise=noise)))
