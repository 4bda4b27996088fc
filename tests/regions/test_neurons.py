"""Neurons in regions: from a file, what is refused of them and where, and layers that send numbers."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from neurorobo.config import Experiment, load_experiment
from neurorobo.engine import Layer
from neurorobo.errors import ConfigError
from neurorobo.experiment.build import build_brain
from neurorobo.experiment.lessons import read_lessons
from neurorobo.experiment.plan import build_plan
from neurorobo.experiment.train import train_experiment
from neurorobo.neurons import NeuronConfig
from neurorobo.plugins import Registry
from neurorobo.regions.spiking_network import Network
from neurorobo.regions.spiking_network_config import NetworkConfig
from neurorobo.synapses import Dense
from neurorobo.testing import check_region
from tests.regions.test_readout_network import types

CORE = [name.removeprefix("core.") for name in Registry().names("neuron") if name.startswith("core.")]
SPIKING = [name for name in CORE if Registry().get("neuron", name).sends_spikes]
SOFT = [name for name in CORE if name not in SPIKING]
LEAST: dict[str, str] = {"snntorch_neuron": "beta: 0.9"}
"""What a file has to say of a neuron, if anything."""

FILE = """\
neurorobo: 1
name: neurons
time: {control: 1 s, spike_step: STEP, window: 40}
episode: {duration: 2 s}
regions:
  cortex:
    type: TYPE
    inputs:
      force: {unit: mN, width: 2, range: -1..1 mN, initial: 0.5 mN, code: {type: population_uniform, neurons: 10}}
    layers:
      hidden: {neurons: 30, reads: [inputs], bias: true, recurrent: RECURRENT, neuron: HIDDEN}
      output: {neurons: 20, reads: [hidden], neuron: OUTPUT}
    outputs: OUTPUTS
steps:
  - say: {use: cortex}
train:
  - {phase: supervise, region: cortex, teacher: test.teacher, data: test.forces, loss: {speed: 40 um/s, move: 1 um},
     steps: STEPS, batch: 16}
"""
CODED = """
      speed: {unit: um/s, range: 0..100 um/s, code: {type: population_uniform, neurons: 10}}
      move: {unit: um, width: 2, range: -2..2 um, code: {type: population_uniform, neurons: 5}}
"""
READ = """
      speed: {unit: um/s, range: 0..100 um/s, reads: [hidden]}
      move: {unit: um, width: 2, range: -2..2 um, reads: [hidden, output]}
"""
FEEDFORWARD = """\
neurorobo: 1
name: feedforward
time: {control: 1 s, spike_step: STEP, window: 10}
episode: {duration: 2 s}
regions:
  cortex:
    type: feedforward
    inputs: {force: {unit: mN, range: -1..1 mN, initial: 0 mN}}
    outputs: {speed: {unit: um/s, range: 0..100 um/s}}
    neuron: HIDDEN
steps:
  - say: {use: cortex}
"""


def named(neuron: str) -> str:
    return f"{{type: {neuron}{', ' if neuron in LEAST else ''}{LEAST.get(neuron, '')}}}"


def load(folder: Path, text: str = FILE, **said: str) -> Experiment:
    said = {"TYPE": "spiking_network", "STEP": "1 ms", "RECURRENT": "false", "HIDDEN": "lif", "OUTPUT": "lif"} | said
    said = {"OUTPUTS": CODED, "STEPS": "2"} | said
    for name in sorted(said, key=len, reverse=True):
        text = text.replace(name, said[name])
    file = folder / "neurons.yaml"
    file.write_text(text)
    experiment = load_experiment(file, (), types())
    build_plan(experiment)
    return experiment


def faults(folder: Path, **said: str) -> str:
    with pytest.raises(ConfigError) as caught:
        load(folder, **said)
    return str(caught.value)


def cortex(experiment: Experiment) -> Network:
    region = build_brain(experiment).region("cortex")
    assert isinstance(region, Network)
    return region


@pytest.mark.parametrize("neuron", SPIKING)
def test_a_network_of_any_neuron_of_the_core_keeps_the_contract_of_a_region(tmp_path: Path, neuron: str) -> None:
    experiment = load(tmp_path, HIDDEN=named(neuron), OUTPUT=named(neuron), RECURRENT="true")
    check_region(experiment.regions["cortex"], experiment.clock)


@pytest.mark.parametrize("neuron", SPIKING)
def test_fresh_neurons_of_the_core_fire_without_any_setting(tmp_path: Path, neuron: str) -> None:
    """Weights are drawn alike for all neurons, so that the defaults have to suit them."""
    region = cortex(load(tmp_path, HIDDEN=named(neuron), OUTPUT=named(neuron)))
    inputs = {"force": (torch.rand(40, 8, 20, generator=torch.Generator().manual_seed(0)) < 0.5).float()}
    rates: dict[str, float] = {}
    region.step(inputs, region.init_state(8), lambda name, fired: rates.update({name: float(fired.detach().mean())}))
    assert 0.02 < rates["hidden"] < 0.9
    assert rates["output"] > 0.005


@pytest.mark.parametrize("neuron", CORE)
def test_what_a_file_says_of_a_neuron_is_what_is_written_back(tmp_path: Path, neuron: str) -> None:
    config = load(tmp_path, HIDDEN=named(neuron)).regions["cortex"]
    assert isinstance(config, NetworkConfig)
    again = tmp_path / "again"
    again.mkdir()
    written = json.dumps(config.layers["hidden"].neuron.model_dump(mode="json", by_alias=True))
    assert load(again, HIDDEN=written).regions["cortex"] == config


def test_a_regime_gives_what_is_left_out(tmp_path: Path) -> None:
    config = load(tmp_path, HIDDEN="{type: izhikevich, regime: chattering, d: 3, c: -52 mV}").regions["cortex"]
    assert isinstance(config, NetworkConfig)
    neuron: Any = config.layers["hidden"].neuron
    assert (neuron.a, neuron.b, neuron.c, neuron.d) == (0.02, 0.2, -52.0, 3.0)


@pytest.mark.parametrize(
    ("neuron", "step", "said"),
    [
        ("{type: exact_lif, membrane_time_constant: 2 ms}", "5 ms", "shorter than half a spike step of 5 ms"),
        ("{type: exact_lif, membrane_time_constant: 200 s}", "1 ms", "longer than 100000 spike steps"),
        ("{type: synaptic_lif, synaptic_time_constant: 1 ms}", "4 ms", "`synaptic_time_constant: 1 ms` is shorter"),
        ("{type: adaptive_lif, adaptation_time_constant: 1 ms}", "4 ms", "`adaptation_time_constant: 1 ms` is"),
        ("{type: izhikevich, longest_substep: 1 ms}", "1 ms", "let `longest_substep` be at most 500 us"),
        ("{type: izhikevich, a: 5}", "1 ms", "let `longest_substep` be at most 0.2 ms"),
        ("{type: izhikevich, longest_substep: 1 us}", "1 ms", "makes 1000 substeps"),
        ("izhikevich", "5 ms", "fires at most once in a spike step"),
        ("adex", "5 ms", "fires at most once in a spike step"),
        ("{type: adex, capacitance: 2 pF}", "1 ms", "overshoots its resting potential; shorten `longest_substep`"),
        ("{type: adex, adaptation_time_constant: 50 us}", "1 ms", "an adaptation of 50 us overshoots"),
        (
            "{type: adex, capacitance: 4 pF, adaptation_time_constant: 120 us, a: 200 nS}",
            "1 ms",
            "throw each other from side to side with `a: 200 nS`",
        ),
    ],
)
def test_a_neuron_that_cannot_run_at_the_spike_step_is_refused_where_it_stands(
    tmp_path: Path, neuron: str, step: str, said: str
) -> None:
    message = faults(tmp_path, HIDDEN=neuron, STEP=step)
    assert "regions.cortex.layers.hidden.neuron: " in message
    assert said in message
    assert "regions.cortex.neuron: " in faults(tmp_path, text=FEEDFORWARD, HIDDEN=neuron, STEP=step)


@pytest.mark.parametrize(
    ("neuron", "said"),
    [
        ("{type: exact_lif, fires: above, reset: subtract}", "`reset: subtract` would take off; leave out one"),
        ("{type: exact_lif, membrane_time_constant: 0 ms}", "must be greater than 0"),
        ("{type: exact_lif, membrane_time_constant: 20}", "20 needs a unit, e.g. '20 ms'"),
        ("{type: izhikevich, regime: chatering}", "chatering"),
        ("{type: izhikevich, c: 40 mV}", "must be less than 30 mV"),
        ("{type: adex, reset_potential: -20 mV}", "`reset_potential` lies below the peak potential of -30.4 mV"),
        ("{type: adex, peak_potential: -60 mV}", "`peak_potential` lies above the `threshold` of -50.4 mV"),
        ("{type: adex, slope_factor: 0.1 mV, peak_potential: 20 mV}", "at most 88 slope factors above"),
        ("{type: adex, capacitance: 281}", "281 needs a unit, e.g. '281 pF'"),
    ],
)
def test_values_that_cannot_be_are_refused_where_they_stand(tmp_path: Path, neuron: str, said: str) -> None:
    message = faults(tmp_path, HIDDEN=neuron)
    assert "regions.cortex.layers.hidden.neuron" in message
    assert said in message


@pytest.mark.parametrize(("largest_ms", "stable"), [(0.99, True), (1.01, False)])
def test_the_bound_of_adex_is_where_its_substeps_become_unstable(largest_ms: float, stable: bool) -> None:
    """At rest, without the upstroke, of a cell whose membrane and adaptation have the same time constant."""
    config: Any = Registry().get("neuron", "adex")
    # (2 tau / h - 1)^2 = a / g_L: of a = 25 g_L, h = tau / 3
    cell = config.model_validate(
        {
            "capacitance": "30 pF",
            "leak_conductance": "10 nS",
            "a": "250 nS",
            "adaptation_time_constant": "3 ms",
            "longest_substep": f"{largest_ms * 1e6:.0f} ns",
        }
    )
    step_ns = round(largest_ms * 1_000_000)
    if stable:
        cell.check(step_ns)
    else:
        with pytest.raises(ValueError, match="throw each other"):
            cell.check(step_ns)
    neuron = cell.build(step_ns)
    state = torch.tensor([[-70.6 - 0.1, 0.0]]).double()
    for _ in range(2000):
        _, state = neuron.step(torch.zeros(1, 1).double(), state)
    assert (abs(float(state[0, 0]) + 70.6) < 0.1) == stable


@pytest.mark.parametrize("neuron", SOFT)
def test_numbers_are_refused_where_spikes_are_needed(tmp_path: Path, neuron: str) -> None:
    message = faults(tmp_path, OUTPUT=neuron)
    assert "regions.cortex.layers.output.neuron: " in message
    assert f"`{neuron}` sends numbers, and here spikes are needed" in message
    assert "regions.cortex.neuron: " in faults(tmp_path, text=FEEDFORWARD, HIDDEN=neuron)
    message = faults(tmp_path, text=FILE.split("train:")[0], TYPE="plastic_network", HIDDEN=neuron)
    assert "regions.cortex.layers.hidden.neuron: " in message


@pytest.mark.parametrize("recurrent", ["false", "true"])
@pytest.mark.parametrize(("kind", "outputs"), [("spiking_network", CODED), ("readout_network", READ)])
def test_a_hidden_layer_that_sends_numbers_trains(tmp_path: Path, kind: str, outputs: str, recurrent: str) -> None:
    errors = []
    for number, steps in enumerate(("1", "80")):
        folder = tmp_path / str(number)
        folder.mkdir()
        soft = "{type: soft_spiking_neural_unit, decay: 0.5, slope: 4}"
        experiment = load(folder, TYPE=kind, HIDDEN=soft, STEPS=steps, OUTPUTS=outputs, RECURRENT=recurrent)
        [report] = train_experiment(experiment, read_lessons(experiment, types()), folder / "out")
        errors.append(report.evaluation["rms"])
    assert all(np.max(errors[1][name]) < 0.8 * np.max(errors[0][name]) for name in ("speed", "move"))


def test_layers_read_the_numbers_as_they_are(tmp_path: Path) -> None:
    region = cortex(load(tmp_path, HIDDEN="{type: soft_spiking_neural_unit, slope: 4}"))
    inputs = {"force": (torch.rand(40, 3, 20, generator=torch.Generator().manual_seed(0)) < 0.5).float()}
    heard: dict[str, torch.Tensor] = {}
    with torch.no_grad():
        region.step(inputs, region.init_state(3), lambda name, sent: heard.update({name: sent.clone()}))
        assert ((heard["hidden"] > 0) & (heard["hidden"] < 1)).all()
        output = region.parameter_groups()["output"]
        assert isinstance(output, Layer)
        (synapses,) = output.projections
        assert isinstance(synapses, Dense) and synapses.graded
        potential = output.at_rest(3)
        for sent, fired in zip(heard["hidden"], heard["output"], strict=True):
            spikes, potential = output.neuron.step(sent @ synapses.weight.t(), potential)
            assert torch.equal(spikes, fired)


def test_all_neurons_of_the_core_say_whether_they_send_spikes() -> None:
    assert SOFT == ["soft_spiking_neural_unit"]
    assert all(issubclass(Registry().get("neuron", name), NeuronConfig) for name in CORE)


def test_thresholds_that_cannot_be_trained_are_refused_where_they_stand(tmp_path: Path) -> None:
    said = faults(tmp_path, HIDDEN="{type: izhikevich}, own_thresholds: true")
    assert "regions.cortex.layers.hidden: `own_thresholds` are for `lif` neurons, and those of `izhikevich`" in said
