"""Spiking networks that say numbers: what a read-out computes, how finely, and that all of it learns from a file."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
import pytest
import torch
import yaml
from torch import Tensor

from neurorobo.clock import Clock
from neurorobo.config import Experiment, load_experiment
from neurorobo.config.plugged_reader import read_plugged
from neurorobo.errors import ConfigError, NeuroroboError
from neurorobo.experiment.lessons import read_lessons
from neurorobo.experiment.train import train_experiment
from neurorobo.interchange.export import to_graph
from neurorobo.learning.phase import DataConfig
from neurorobo.plugins import Registrar, Registry, hookimpl
from neurorobo.regions import Port, RegionConfig
from neurorobo.regions.readout_network import Readout, ReadoutNetwork
from neurorobo.regions.readout_network_config import ReadoutConfig, ReadoutNetworkConfig
from neurorobo.regions.region import Probe, Region, State
from neurorobo.regions.weights_file import signature_hash
from neurorobo.testing import check_region
from tests.experiment import toys
from tests.regions.toys import CLOCK

HERE = "tests.regions.test_readout_network"
READINGS: list[dict[str, Any]] = [
    {},
    {"takes": "last", "decay": 0.9},
    {"takes": "mean", "decay": 0.5},
    {"takes": "largest", "decay": 0.8},
]
readings = pytest.mark.parametrize("reading", READINGS, ids=lambda reading: reading.get("takes", "rate"))
linear_readings = pytest.mark.parametrize("reading", READINGS[:3], ids=lambda reading: reading.get("takes", "rate"))


def network(**outputs: Any) -> ReadoutNetworkConfig:
    described = {
        "type": "readout_network",
        "carry": "always",
        "inputs": {"force": {"unit": "mN", "width": 2, "range": "-1..1 mN", "code": {"type": "population_signed"}}},
        "layers": {
            "hidden": {"neurons": 12, "reads": ["inputs"], "bias": True},
            "motor": {"neurons": 7, "reads": ["hidden"]},
        },
        "outputs": {
            "speed": {"unit": "um/s", "range": "0..100 um/s", "reads": ["motor"]},
            "move": {
                "unit": "um",
                "width": 2,
                "range": "-2..2 um",
                "reads": ["hidden", "motor"],
                "takes": "last",
                "decay": 0.9,
            },
        },
    }
    config = read_plugged("region", {**described, **({"outputs": outputs} if outputs else {})}, Registry())
    assert isinstance(config, ReadoutNetworkConfig)
    return config


def readout(lo: float = -3.0, hi: float = 5.0, sources: int = 6, gain: float = 0.2, **reading: Any) -> Readout:
    described = {"unit": "mN", "width": 2, "range": f"{lo}..{hi} mN", "reads": ["motor"], **reading}
    return Readout(ReadoutConfig.model_validate(described), sources, torch.Generator().manual_seed(0), gain)


def spikes(steps: int = 20, batch: int = 3, sources: int = 6, seed: int = 0) -> Tensor:
    return (torch.rand(steps, batch, sources, generator=torch.Generator().manual_seed(seed)) < 0.3).float()


@readings
def test_it_keeps_the_contract_of_regions(reading: dict[str, Any]) -> None:
    check_region(network())
    check_region(network(speed={"unit": "um/s", "range": "0..100 um/s", "reads": ["hidden"], **reading}), CLOCK)


def test_a_rate_is_the_weighted_sum_of_firing_rates_and_a_bias() -> None:
    weigh = readout()
    with torch.no_grad():
        weigh.bias.copy_(torch.tensor([[0.1], [-0.2]]))
    given = spikes()
    rates = given.mean(0).numpy()
    wanted = 1 + 4 * (rates @ weigh.synapses.weight.detach().numpy().T + [0.1, -0.2])
    said, _ = weigh(given, torch.full((3, 2), 7.0))  # no rate remembers
    np.testing.assert_allclose(said.detach(), wanted, rtol=1e-5)


@pytest.mark.parametrize("takes", ["last", "mean", "largest"])
def test_a_potential_is_that_of_a_neuron_of_snntorch_that_does_not_fire(takes: str) -> None:
    snntorch = pytest.importorskip("snntorch")
    decay, weigh = 0.85, readout(takes=takes, decay=0.85)
    neuron = snntorch.Leaky(beta=decay, reset_mechanism="none")
    potential = before = torch.tensor([[0.3, -0.1]]).expand(3, 2)
    given, potentials = spikes(), []
    for now in given:
        _, potential = neuron((1 - decay) * torch.nn.functional.linear(now, weigh.synapses.weight), potential)
        potentials.append(potential)
    trace = torch.stack(potentials)
    wanted = {"last": trace[-1], "mean": trace.mean(0), "largest": trace.max(0).values}[takes]
    said, after = weigh(given, before)
    torch.testing.assert_close(said, 1 + 4 * wanted)
    torch.testing.assert_close(after, potential)


@readings
def test_windows_in_a_row_are_one_long_window_to_a_potential(reading: dict[str, Any]) -> None:
    weigh, given = readout(**reading), spikes(steps=30)
    rest = torch.zeros(3, 2)
    _, between = weigh(given[:18], rest)
    _, after = weigh(given[18:], between)
    torch.testing.assert_close(after, weigh(given, rest)[1])


@linear_readings
def test_one_spike_more_moves_the_number_by_the_stated_resolution(reading: dict[str, Any]) -> None:
    weigh, given, steps = readout(**reading), spikes(), 20
    decay = reading.get("decay", 0.0)
    said, _ = weigh(given, torch.zeros(3, 2))
    for step, neuron in ((0, 2), (7, 0), (19, 5)):
        more = given.clone()
        more[step, :, neuron] += 1
        left = [(1 - decay) * decay**age for age in range(steps - step)]
        share = left[-1] if reading.get("takes") == "last" else sum(left) / steps
        moved = 4 * share * weigh.synapses.weight[:, neuron]
        torch.testing.assert_close(weigh(more, torch.zeros(3, 2))[0] - said, moved.expand(3, 2), rtol=1e-3, atol=2e-6)


@readings
def test_what_goes_beyond_the_range_saturates_and_still_learns(reading: dict[str, Any]) -> None:
    weigh = readout(**reading)
    with torch.no_grad():
        weigh.bias.copy_(torch.tensor([[50.0], [-50.0]]))
    said, _ = weigh(spikes(), torch.zeros(3, 2))
    assert said.tolist() == [[5.0, -3.0]] * 3
    said.sum().backward()
    assert weigh.bias.grad is not None
    assert (weigh.bias.grad > 0).all()


def test_an_output_reads_its_own_layers_and_is_a_group_of_its_own() -> None:
    region = ReadoutNetwork(network(), CLOCK, torch.Generator().manual_seed(0))
    groups = region.parameter_groups()
    assert [*groups] == ["hidden", "motor", "speed", "move"]
    assert groups["speed"].synapses.weight.shape == (1, 7)  # type: ignore[union-attr]
    assert groups["move"].synapses.weight.shape == (2, 19)  # type: ignore[union-attr]
    counted = sum(parameter.numel() for group in groups.values() for parameter in group.parameters())
    assert counted == sum(parameter.numel() for parameter in region.parameters())


def test_weights_hang_on_how_layers_are_read_and_not_on_units_and_ranges() -> None:
    speed = {"unit": "um/s", "range": "0..100 um/s", "reads": ["motor"]}
    same, other = {"unit": "mm/s", "range": "0..1 mm/s"}, {"takes": "last", "decay": 0.9}
    first, second, third = (signature_hash(network(speed={**speed, **more}), CLOCK) for more in ({}, same, other))
    assert first == second != third


@pytest.mark.parametrize(
    ("speed", "words"),
    [
        ({"reads": ["motr"]}, "the output `speed` reads `motr`, which is no layer; did you mean `motor`?"),
        ({"reads": []}, "at least 1"),
        ({"decay": 0.5}, "a rate has no `decay`; leave it out, or take the `last`, `mean` or `largest` potential"),
        ({"takes": "last"}, "the last potential needs a `decay`, such as 0.9"),
        ({"takes": "last", "decay": 1.0}, "less than 1"),
        ({"takes": "first"}, "'rate', 'last', 'mean' or 'largest'"),
        ({"range": "3..3 um/s"}, "does not rise; write the smaller end first"),
        ({"range": "0..3 um"}, "is a length, wanted a speed"),
        ({"unit": "umm"}, "'umm' is not a unit"),
        ({"code": "poisson"}, "unknown key `code`"),
    ],
)
def test_what_makes_no_sense_is_refused(speed: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError) as caught:
        network(speed={"unit": "um/s", "range": "0..100 um/s", "reads": ["motor"], **speed})
    assert words in str(caught.value)


def test_an_output_cannot_be_called_as_a_layer() -> None:
    with pytest.raises(ConfigError, match="an output and a layer are both called `motor`"):
        network(motor={"unit": "um/s", "range": "0..100 um/s", "reads": ["motor"]})


def test_what_only_says_numbers_is_not_exported() -> None:
    pytest.importorskip("nir", reason="of the extra `nir`")
    region = ReadoutNetwork(network(), CLOCK, torch.Generator().manual_seed(0))
    with pytest.raises(NeuroroboError, match="none of its outputs carries spikes"):
        to_graph(region, Registry())


def test_the_regions_of_the_documentation_can_be_read() -> None:
    page = Path(__file__).parents[2] / "docs" / "explanation" / "codes_and_readouts.md"
    found = set()
    for block in re.findall(r"^```yaml\n(.*?)^```", page.read_text(), re.DOTALL | re.MULTILINE):
        written = yaml.safe_load(block)
        for region in written.get("regions", written).values():
            if isinstance(region, dict) and "type" in region:
                found.add(read_plugged("region", region, Registry()).type)  # type: ignore[attr-defined]
    assert found == {"delta_encoder", "delta_decoder", "readout_network"}


class TeacherConfig(RegionConfig):
    """A speed that falls with one force, and the sine of both as a move."""

    implementation: ClassVar[str] = f"{HERE}:Teacher"
    type: Literal["test.teacher"] = "test.teacher"

    def inputs(self, clock: Clock) -> dict[str, Port]:
        return {"force": Port("mN", 2)}

    def outputs(self, clock: Clock) -> dict[str, Port]:
        return {"speed": Port("um/s"), "move": Port("um", 2)}


class Teacher(Region):
    def step(
        self, inputs: Mapping[str, Tensor], state: State, probe: Probe | None = None
    ) -> tuple[dict[str, Tensor], State]:
        force = inputs["force"]
        return {"speed": 50 - 40 * force[:, :1], "move": (2 * force).sin()}, state


class ForcesConfig(DataConfig):
    implementation: ClassVar[str] = f"{HERE}:Forces"
    type: Literal["test.forces"] = "test.forces"


class Forces:
    def __init__(self, config: ForcesConfig, clock: Clock) -> None: ...

    def draw(self, batch: int, generator: torch.Generator) -> dict[str, Tensor]:
        return {"force": 2 * torch.rand(batch, 2, generator=generator) - 1}


class Plugin:
    @hookimpl
    def neurorobo_register(self, registry: Registrar) -> None:
        registry.add("region", "test.teacher", f"{HERE}:TeacherConfig")
        registry.add("data", "test.forces", f"{HERE}:ForcesConfig")


def types() -> Registry:
    registry = toys.registry()
    registry.add_plugin("test", Plugin())
    return registry


def train(folder: Path, text: str) -> Any:
    folder.mkdir(exist_ok=True)
    file = folder / "taught.yaml"
    file.write_text(text)
    experiment: Experiment = load_experiment(file, (), types())
    [report] = train_experiment(experiment, read_lessons(experiment, types()), folder / "out")
    return report


TAUGHT = """\
neurorobo: 1
name: taught
time: {control: 1 s, spike_step: 1 ms, window: 20}
episode: {duration: 2 s}
regions:
  cortex:
    type: readout_network
    inputs:
      force: {unit: mN, width: 2, range: -1..1 mN, code: {type: gaussian_receptive_fields, neurons: 12}, initial: 0 mN}
    layers:
      hidden: {neurons: 60, reads: [inputs]}
    outputs:
      speed: {unit: um/s, range: 0..100 um/s, reads: [hidden]}
      move: {unit: um, width: 2, range: -2..2 um, reads: [hidden], READING}
steps:
  - say: {use: cortex}
train:
  - {phase: supervise, region: cortex, teacher: test.teacher, data: test.forces, loss: {speed: 40 um/s, move: 1 um},
     steps: STEPS, batch: 32, freeze: FROZEN}
"""


@pytest.mark.parametrize("reading", ["takes: rate", "takes: last, decay: 0.9"])
def test_layers_and_readouts_learn_together_from_a_teacher(tmp_path: Path, reading: str) -> None:
    def errors(name: str, steps: int, frozen: str = "[]") -> Any:
        text = TAUGHT.replace("READING", reading).replace("STEPS", str(steps)).replace("FROZEN", frozen)
        return train(tmp_path / name, text).evaluation["rms"]

    fresh, taught, readouts_alone = errors("fresh", 1), errors("taught", 120), errors("alone", 120, "[hidden]")
    for output in ("speed", "move"):
        assert np.max(taught[output]) < np.max(fresh[output]) / 3
        assert np.max(taught[output]) < 0.8 * np.max(readouts_alone[output])


CART = """\
neurorobo: 1
name: cart
seed: 3
time: {control: 1 s, spike_step: 1 ms, window: 20}
body: {type: toy.cart, noise: 0.1}
task: {type: toy.reach, goal_um: 5.0}
regions:
  driver: {type: toy.drive}
  pilot:
    type: readout_network
    CARRY
    inputs:
      position: {unit: um, width: 2, range: -10..10 um, code: {type: gaussian_receptive_fields, neurons: 10}}
    layers:
      hidden: {neurons: 30, reads: [inputs]}
      motor: {neurons: 20, reads: [hidden]}
    outputs:
      speed: {unit: um/s, range: 0..1 um/s, reads: [motor], READING}
steps:
  - drive: {use: driver, position: body.position}
  - steer: {use: pilot, position: body.position}
command: {speed: steer.speed, nudge: drive.nudge}
train:
  - {phase: ppo, regions: {pilot: [hidden, motor, speed]}, explore: {speed: 0.2 um/s}, iterations: 8, episodes: 16,
     minibatch: 32, epochs: 3, learning_rate: 0.03, validation: {episodes: 8, every: 2}, held_out: {episodes: 8}}
"""


@pytest.mark.parametrize(
    ("reading", "carry"), [("takes: rate", ""), ("takes: last, decay: 0.9", "carry: always")], ids=["rate", "potential"]
)
def test_a_population_of_spiking_neurons_learns_to_drive_by_reward(tmp_path: Path, reading: str, carry: str) -> None:
    report = train(tmp_path, CART.replace("READING", reading).replace("CARRY", carry))
    before, after = (report.evaluation["held_out"][when] for when in ("before", "after"))
    assert np.mean(after["return"]) > np.mean(before["return"]) + 1.0
    assert np.mean(after["duration_s"]) < np.mean(before["duration_s"]) - 0.3
