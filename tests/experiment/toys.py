"""A brain for the cart of `tests.tasks.toys`: one region that drives, one that spikes, and recorders that watch."""

from collections.abc import Mapping
from pathlib import Path
from typing import ClassVar, Literal

import torch
from torch import Tensor

from neurorobo.clock import Clock
from neurorobo.codes import Poisson
from neurorobo.errors import NeuroroboError
from neurorobo.experiment.recorder import Recorder, Sample, Setting
from neurorobo.graph.brain import Brain
from neurorobo.graph.compile import compile_graph
from neurorobo.graph.spec import StepSpec
from neurorobo.plugins import Registrar, Registry, hookimpl
from neurorobo.regions import Port, RegionConfig
from neurorobo.regions.region import Probe, Region, State
from tests.regions.toys import Net, NetConfig
from tests.tasks.toys import Cart, CartConfig, ReachConfig

SECOND = 1_000_000_000
CLOCK = Clock({"control": SECOND, "slow": 2 * SECOND}, 1_000_000, 20)


class DriveConfig(RegionConfig):
    """Drives towards the goal and back to the middle of the rail; a ``gain`` above 1/s asks for more than allowed."""

    implementation: ClassVar[str] = "tests.experiment.toys:Drive"
    type: Literal["toy.drive"] = "toy.drive"
    gain: float = 4.0

    def inputs(self, clock: Clock) -> dict[str, Port]:
        return {"position": Port("um", 2)}

    def outputs(self, clock: Clock) -> dict[str, Port]:
        return {"speed": Port("um/s"), "nudge": Port("um", 2)}


class Drive(Region):
    """Proportional control."""

    def step(
        self, inputs: Mapping[str, Tensor], state: State, probe: Probe | None = None
    ) -> tuple[dict[str, Tensor], State]:
        assert isinstance(self.config, DriveConfig)
        x, y = inputs["position"].split(1, dim=1)
        nudge = torch.cat([torch.zeros_like(y), -0.5 * y], dim=1)
        return {"speed": self.config.gain * (3.5 - x), "nudge": nudge}, state


class NoisyConfig(NetConfig):
    """The small network, told the force by a Poisson code."""

    type: Literal["toy.noisy"] = "toy.noisy"  # type: ignore[assignment]

    def inputs(self, clock: Clock) -> dict[str, Port]:
        return {"force": Port("mN", 2, Poisson(self.neurons, -1.0, 1.0))}


def brain(gain: float = 4.0, watcher: NetConfig | None = None) -> Brain:
    """The driver at every control period, and the network that watches the force at every other one."""
    regions = {"driver": DriveConfig(gain=gain), "watcher": watcher or NetConfig()}
    steps = [
        StepSpec("drive", "driver", inputs={"position": "body.position"}),
        StepSpec("watch", "watcher", every="slow", inputs={"force": "body.force"}),
    ]
    body = CartConfig()
    command = {"speed": "drive.speed", "nudge": "drive.nudge"}
    plan = compile_graph(steps, command, regions, CLOCK, body.sensors(), body.actuators())
    generator = torch.Generator().manual_seed(0)
    built = {"driver": Drive(regions["driver"], CLOCK, generator), "watcher": Net(regions["watcher"], CLOCK, generator)}
    return Brain(plan, built)


CART = """\
neurorobo: 1
name: cart
seed: 7
time: {control: 1 s, slow: 2 s, spike_step: 1 ms, window: 20}
body: {type: toy.cart, noise: 0.8}
task: {type: toy.reach}
regions:
  driver: {type: toy.drive, gain: 4.0}
  watcher: {type: toy.net}
steps:
  - drive: {use: driver, position: body.position}
  - watch: {use: watcher, every: slow, force: body.force}
command: {speed: drive.speed, nudge: drive.nudge}
record: [trajectory]
"""


class Notes(Recorder):
    """Keeps every sample."""

    most_neurons = 1000
    samples: list[Sample]

    def __init__(self, setting: Setting | None = None) -> None:
        if setting is not None:
            super().__init__(setting)
        self.samples = []

    def sample(self, sample: Sample) -> None:
        self.samples.append(sample)

    def finish(self) -> Path | None:
        return None


class Impatient(Notes):
    """Presses Ctrl-C at the third tick."""

    error: ClassVar[BaseException] = KeyboardInterrupt()

    def sample(self, sample: Sample) -> None:
        if sample.tick == 2:
            raise self.error


class Clumsy(Impatient):
    """Fails at the third tick."""

    error = ZeroDivisionError()


class MissingConfig(NetConfig):
    """Its network is in a module that there is not."""

    implementation: ClassVar[str] = "tests.experiment.gone:Gone"
    type: Literal["toy.missing"] = "toy.missing"  # type: ignore[assignment]


class FilelessConfig(NetConfig):
    """Its network needs a file that there is not."""

    implementation: ClassVar[str] = "tests.experiment.toys:Fileless"
    type: Literal["toy.fileless"] = "toy.fileless"  # type: ignore[assignment]


class Fileless(Net):
    def __init__(self, *arguments: object) -> None:
        Path("/nowhere/table.csv").read_text()


class BrokenCartConfig(CartConfig):
    implementation: ClassVar[str] = "tests.experiment.toys:BrokenCart"
    type: Literal["toy.broken_cart"] = "toy.broken_cart"  # type: ignore[assignment]


class BrokenCart:
    def __init__(self, config: BrokenCartConfig) -> None:
        raise OSError("no cart is connected")


class FarReachConfig(ReachConfig):
    implementation: ClassVar[str] = "tests.experiment.toys:FarReach"
    type: Literal["toy.far_reach"] = "toy.far_reach"  # type: ignore[assignment]


class FarReach:
    def __init__(self, config: FarReachConfig, body: Cart) -> None:
        raise NeuroroboError("the goal is too far for this body; bring it nearer")


class Plugin:
    """Registers the toys."""

    @hookimpl
    def neurorobo_register(self, registry: Registrar) -> None:
        registry.add("region", "toy.drive", "tests.experiment.toys:DriveConfig")
        registry.add("region", "toy.net", "tests.regions.toys:NetConfig")
        registry.add("region", "toy.missing", "tests.experiment.toys:MissingConfig")
        registry.add("region", "toy.fileless", "tests.experiment.toys:FilelessConfig")
        registry.add("body", "toy.broken_cart", "tests.experiment.toys:BrokenCartConfig")
        registry.add("task", "toy.far_reach", "tests.experiment.toys:FarReachConfig")
        registry.add("body", "toy.cart", "tests.tasks.toys:CartConfig")
        registry.add("task", "toy.reach", "tests.tasks.toys:ReachConfig")
        registry.add("recorder", "toy.impatient", "tests.experiment.toys:Impatient")
        registry.add("recorder", "toy.greedy", "tests.experiment.test_run:Greedy")
        registry.add("recorder", "toy.unmade", "tests.experiment.test_run:Unmade")
        registry.add("recorder", "toy.clumsy", "tests.experiment.toys:Clumsy")


def registry() -> Registry:
    """The core's types and the toys."""
    registry = Registry()
    registry.add_plugin("toy", Plugin())
    return registry
