"""The general region: any inputs, outputs, neuron and code, those of a plugin too."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import pytest
import torch
from pydantic import ValidationError
from torch import Tensor

from neurorobo.clock import Clock
from neurorobo.codes import PopulationUniform
from neurorobo.config import Experiment, load_experiment
from neurorobo.config.document import dump
from neurorobo.errors import ConfigError
from neurorobo.experiment.build import build_brain
from neurorobo.experiment.closed_loop import run_episodes
from neurorobo.learning.evaluate import evaluate
from neurorobo.learning.phase import SupervisePhase
from neurorobo.learning.supervise import supervise
from neurorobo.neurons import LIF
from neurorobo.neurons.config import LIFConfig, SpikingNeuralUnitConfig
from neurorobo.plugins import Registry
from neurorobo.regions import Port, RegionConfig
from neurorobo.regions.feedforward import Feedforward
from neurorobo.regions.feedforward_config import FeedforwardConfig
from neurorobo.regions.region import Probe, Region, State
from neurorobo.testing import check_region
from tests.regions import acme
from tests.regions.toys import CLOCK

FILE = Path(__file__).with_name("acme.yaml")


def registry() -> Registry:
    registry = Registry()
    registry.add_plugin("acme", acme)
    return registry


def load(*overrides: str) -> Experiment:
    return load_experiment(FILE, overrides, registry())


def cortex(experiment: Experiment) -> FeedforwardConfig:
    config = experiment.regions["cortex"]
    assert isinstance(config, FeedforwardConfig)
    return config


def test_a_file_uses_the_neuron_and_the_code_of_a_plugin_and_runs() -> None:
    experiment = load()
    assert cortex(experiment).inputs(CLOCK) == {"force": Port("mN", 2, acme.Burst(4, -1.0, 1.0), (0.5, 0.5))}
    assert cortex(experiment).outputs(CLOCK) == {"speed": Port("um/s", 1, PopulationUniform(10, 0.0, 100.0))}
    brain = build_brain(experiment)
    region = brain.region("cortex")
    assert isinstance(region, Feedforward)
    assert [layer.neuron for layer in region.layers.values()] == [acme.Adaptive(0.2)] * 3
    assert experiment.episode is not None
    [result] = run_episodes(brain, None, [0], duration_ns=experiment.episode.duration)
    assert all(0.01 < rate < 0.9 for rate in result.firing_rates.values())


def test_a_plugins_neuron_changes_what_the_region_says() -> None:
    quiet, eager = (build_brain(load(f"regions.cortex.neuron.rise={rise}")).region("cortex") for rise in ("5.0", "0.0"))
    spikes = acme.Burst(4, -1.0, 1.0).encode(torch.full((1, 2), 0.8), 20)
    rates = [region.step({"force": spikes}, region.init_state(1))[0]["speed"].mean() for region in (quiet, eager)]
    assert rates[0] < rates[1] / 2


def test_the_resolved_file_loads_to_the_same(tmp_path: Path) -> None:
    experiment = load()
    described = experiment.resolved()["regions"]["cortex"]
    assert described["neuron"] == {"type": "acme.adaptive", "rise": 0.2}
    assert described["outputs"]["speed"]["range"] == "0..100 um/s"
    assert described["outputs"]["speed"]["code"] == {"type": "population_uniform", "neurons": 10}
    file = tmp_path / "again.yaml"
    file.write_text(dump(experiment.resolved()))
    assert load_experiment(file, (), registry()) == experiment


@pytest.mark.parametrize(
    ("override", "place", "words"),
    [
        ("neuron.type=acme.adaptve", "neuron.type", "did you mean `acme.adaptive`"),
        ("neuron.rise=-1", "neuron.rise", "must be greater than or equal to 0 (got -1)"),
        ("neuron=acme.burst", "neuron", "is a code, not a neuron"),
        ("inputs.force.code.neurons=0", "inputs.force.code.neurons", "must be greater than or equal to 1"),
        ("inputs.force.code.neuron=2", "inputs.force.code", "unknown key `neuron`; did you mean `neurons`"),
        ("inputs.force.range=0..3 um", "inputs.force.range", "is a length, wanted a force"),
        ("inputs.force.range=3", "inputs.force.range", "must be text"),
        ("inputs.force.initial=3", "inputs.force.initial", "needs a unit, e.g. '3 mN'"),
        ("inputs.force.unit=mNN", "inputs.force.unit", "'mNN' is not a unit"),
        ("hidden=[3, 0]", "hidden.1", "must be greater than or equal to 1"),
        ("outputs={}", "outputs", "at least 1"),
    ],
)
def test_a_fault_in_the_file_is_told_at_its_place(override: str, place: str, words: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load(f"regions.cortex.{override}")
    [fault] = caught.value.faults
    assert ".".join(map(str, fault.path)).startswith(f"regions.cortex.{place}")
    assert words in fault.message


def test_a_bare_name_is_a_type_with_its_defaults_and_the_core_needs_no_prefix() -> None:
    experiment = load("regions.cortex.neuron=spiking_neural_unit", "regions.cortex.inputs.force.code=poisson")
    assert cortex(experiment).neuron == SpikingNeuralUnitConfig()
    assert cortex(experiment).neuron.build(10**6) == LIF(rectify=True)
    assert cortex(experiment).receives["force"].code.type == "poisson"


def test_names_cannot_be_read_where_there_is_no_registry() -> None:
    with pytest.raises(ValidationError, match="only be read where its plugin is known"):
        FeedforwardConfig.model_validate(
            {"inputs": PORTS, "outputs": PORTS, "neuron": "lif"},
        )


PORTS: dict[str, Any] = {"x": {"unit": "mN", "width": 2, "range": "-1..1 mN"}}


def config(**settings: Any) -> FeedforwardConfig:
    return FeedforwardConfig.model_validate({"inputs": PORTS, "outputs": {"y": PORTS["x"]}, **settings})


@pytest.mark.parametrize(
    "settings",
    [{}, {"neuron": acme.AdaptiveConfig(), "hidden": []}, {"carry": "always", "neuron": LIFConfig(threshold=0.3)}],
)
def test_it_keeps_the_contract(settings: dict[str, Any]) -> None:
    check_region(config(**settings))


class HalfConfig(RegionConfig):
    implementation: ClassVar[str] = "none"
    type: str = "half"

    def inputs(self, clock: Clock) -> dict[str, Port]:
        return {"x": Port("mN", 2)}

    def outputs(self, clock: Clock) -> dict[str, Port]:
        return {"y": Port("mN", 2)}


class Half(Region):
    def step(
        self, inputs: Mapping[str, Tensor], state: State, probe: Probe | None = None
    ) -> tuple[dict[str, Tensor], State]:
        return {"y": inputs["x"] / 2}, state


class EvenData:
    def draw(self, batch: int, generator: torch.Generator) -> dict[str, Tensor]:
        return {"x": torch.rand(batch, 2, generator=generator) * 2 - 1}


@pytest.mark.parametrize("neuron", [LIFConfig(), acme.AdaptiveConfig()], ids=lambda neuron: neuron.type)
def test_it_learns_from_a_teacher_with_any_neuron(neuron: Any) -> None:
    region = Feedforward(config(neuron=neuron, hidden=[40]), CLOCK, torch.Generator().manual_seed(1))
    teacher = Half(HalfConfig(), CLOCK, torch.Generator())
    phase = SupervisePhase(region="r", teacher="t", data="d", loss={"y": "0.1 mN"}, steps=100, batch=16)

    def rms() -> float:
        found = evaluate(region, teacher, EvenData(), torch.Generator().manual_seed(3), outputs=["y"], batches=4)
        return float(found.rms["y"].max())

    untrained = rms()
    supervise(region, teacher, EvenData(), phase, torch.Generator().manual_seed(2))
    assert rms() < untrained / 2
    assert set(region.parameter_groups()) == {"hidden_1", "output"}
