"""A plugin `zoo`, as a third party would write it, and what loads experiments with it."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import pytest
from pydantic import BaseModel, ConfigDict, Field, model_validator

from neurorobo.bodies import Actuator, BodyConfig, Sensor
from neurorobo.clock import Clock
from neurorobo.config import Experiment, load_experiment
from neurorobo.errors import ConfigError
from neurorobo.plugged_field import Plugged
from neurorobo.plugins import Registrar, Registry, hookimpl
from neurorobo.regions import Port, RegionConfig
from neurorobo.tasks import TaskConfig
from neurorobo.units import Duration, Interval, Unit


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Spiking(_Strict):
    kind: Literal["spiking"] = "spiking"
    time_constant: Duration = 20_000_000
    decay: float = Field(default=0.5, lt=1)


class Adaptive(_Strict):
    kind: Literal["adaptive"] = "adaptive"
    strength: float = 0.1


class Neuron(_Strict):
    type: str
    threshold: Annotated[float, Unit("mV", gt=0)] = 1.0


class Cortex(RegionConfig):
    """A region with one field of every sort."""

    implementation: ClassVar[str] = "nowhere:Cortex"
    size: int = Field(gt=0)
    speed: Annotated[Interval, Unit("um/s")] = Interval(0, 100)
    gain: Annotated[float, Unit("mN/um", gt=0)] = 80.0
    membrane: Annotated[Spiking | Adaptive, Field(discriminator="kind")] = Spiking()
    neuron: Annotated[Neuron, Plugged("neuron")] | None = None
    layers: int | list[int] = 3
    offsets: tuple[Annotated[float, Unit("um")], ...] = ()

    @model_validator(mode="after")
    def _fits(self) -> "Cortex":
        if self.size == 13:
            raise ValueError("13 neurons bring bad luck; take 12")
        return self

    def inputs(self, clock: Clock) -> dict[str, Port]:
        return {}

    def outputs(self, clock: Clock) -> dict[str, Port]:
        return {}


class Rig(BodyConfig):
    implementation: ClassVar[str] = "nowhere:Rig"
    stage_resolution: Annotated[float, Unit("um", gt=0)] = 0.5

    def sensors(self) -> dict[str, Sensor]:
        return {}

    def actuators(self) -> dict[str, Actuator]:
        return {}


class Reach(TaskConfig):
    implementation: ClassVar[str] = "nowhere:Reach"
    goal: Annotated[float, Unit("um")] = 1.0


class Drill(_Strict):
    phase: str
    epochs: int = Field(default=1, ge=1)


NOT_A_MODEL = 3


class _Zoo:
    @hookimpl
    def neurorobo_register(self, registry: Registrar) -> None:
        registry.add("region", "zoo.cortex", f"{__name__}:Cortex")
        registry.add("region", "zoo.ghost", "no_such_module:Ghost")
        registry.add("region", "zoo.stone", f"{__name__}:NOT_A_MODEL")
        registry.add("body", "zoo.rig", f"{__name__}:Rig")
        registry.add("task", "zoo.reach", f"{__name__}:Reach")
        registry.add("rule", "zoo.drill", f"{__name__}:Drill")
        registry.add("neuron", "zoo.neuron", f"{__name__}:Neuron")
        registry.add("recorder", "zoo.tape", "no_such_module:Tape")


@pytest.fixture
def registry() -> Registry:
    registry = Registry()
    registry.add_plugin("zoo", _Zoo())
    return registry


Load = Callable[..., Experiment]
Faults = Callable[..., list[str]]


@pytest.fixture
def load(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, registry: Registry) -> Load:
    """Return a function that loads a text as the file ``x.yaml``, with overrides."""
    monkeypatch.chdir(tmp_path)

    def load(text: str, *overrides: str) -> Experiment:
        Path("x.yaml").write_text(text, encoding="utf-8")
        return load_experiment("x.yaml", overrides, registry)

    return load


@pytest.fixture
def faults(load: Load) -> Faults:
    """Return a function that loads a text and returns the lines of the error."""

    def faults(text: str, *overrides: str) -> list[str]:
        with pytest.raises(ConfigError) as caught:
            load(text, *overrides)
        return str(caught.value).splitlines()

    return faults
