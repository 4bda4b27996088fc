"""A network whose synapses learn while it runs: of every kind, by every rule, each member of a batch by itself."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import pytest
import torch
import yaml
from torch import Tensor

from neurorobo.bodies import Sensor
from neurorobo.clock import Clock
from neurorobo.config.plugged_reader import read_plugged
from neurorobo.errors import ConfigError
from neurorobo.graph.compile import compile_graph
from neurorobo.graph.spec import StepSpec
from neurorobo.plugins import Registry
from neurorobo.regions.config import checked_ports
from neurorobo.regions.plastic_network import PlasticNetwork
from neurorobo.regions.plastic_network_config import PlasticNetworkConfig
from neurorobo.regions.region import State
from neurorobo.regions.spiking_network import Network
from neurorobo.regions.weights import load_weights, save_weights, to_grid
from neurorobo.testing import check_region

CLOCK = Clock({"control": 50_000_000}, 1_000_000, 50)
EVERY = yaml.safe_load(Path(__file__).with_name("plastic_network.yaml").read_text())


def read(value: Mapping[str, Any]) -> PlasticNetworkConfig:
    config = read_plugged("region", value, Registry())
    assert isinstance(config, PlasticNetworkConfig)
    return config


def build(value: Mapping[str, Any], seed: int = 1) -> PlasticNetwork:
    region = PlasticNetwork(read(value), CLOCK, torch.Generator().manual_seed(seed))
    region.load_state_dict(
        {
            name: to_grid(weight) if weight.is_floating_point() else weight
            for name, weight in region.state_dict().items()
        }
    )
    return region


def inputs(region: PlasticNetwork, window: int, batch: int) -> dict[str, Tensor]:
    """What each member receives depends on the window and the member alone."""
    found = {}
    for name, port in region.input_ports.items():
        rows = []
        for member in range(batch):
            generator = torch.Generator().manual_seed(1000 * window + member)
            values = torch.rand(1, port.width, generator=generator)
            spikes = port.code and port.code.encode(400 * values, CLOCK.window, generator)
            rows.append(values - 0.5 if spikes is None else spikes)
        found[name] = torch.cat(rows, dim=0 if port.code is None else 1)
    return found


@torch.no_grad()
def run(region: PlasticNetwork, windows: int, batch: int) -> tuple[Tensor, State]:
    state, spikes = region.init_state(batch), []
    for window in range(windows):
        outputs, state = region.step(inputs(region, window, batch), state)
        spikes.append(outputs["rate"])
    return torch.cat(spikes), state


@pytest.mark.parametrize("state", ["fork", "fresh"])
def test_a_graph_that_throws_away_all_that_is_learned_is_refused(state: Literal["fork", "fresh"]) -> None:
    config = read(EVERY)
    sensors = {name: Sensor(port.unit, port.width) for name, port in config.inputs(CLOCK).items()}
    wires = {name: f"body.{name}" for name in sensors}
    look = StepSpec("look", "network", state=state, inputs=wires)
    with pytest.raises(ConfigError, match=r"no step keeps the state of `network`.*leave `state` out of a step"):
        compile_graph([look], {}, {"network": config}, CLOCK, sensors, {})
    compile_graph([look, StepSpec("act", "network", inputs=wires)], {}, {"network": config}, CLOCK, sensors, {})


def test_it_keeps_the_contract_with_every_rule_and_every_kind_of_synapses() -> None:
    check_region(read(EVERY), CLOCK)


def test_all_synapses_that_learn_change_and_parameters_do_not() -> None:
    region = build(EVERY)
    before = {name: value.clone() for name, value in region.state_dict().items()}
    _, state = run(region, 10, 2)
    assert region.learned == (
        "hidden.cue.change",
        "hidden.recurrent.change",
        "purkinje.granule.change",
        "purkinje.hidden.change",
    )
    for name in region.learned:
        assert state[name].abs().max() > 1e-4, name
        assert not torch.equal(*state[name]), name
    for name, value in region.state_dict().items():
        assert torch.equal(value, before[name])


def test_members_of_a_batch_learn_bit_for_bit_what_they_learn_alone() -> None:
    region = build(EVERY)
    together, state = run(region, 10, 3)
    alone, own = run(region, 10, 1)
    assert torch.equal(together[:, :1], alone)
    for name, value in state.items():
        assert torch.equal(value[:1], own[name]), name


@torch.no_grad()
def test_learned_synapses_do_what_such_weights_do() -> None:
    """What a network has learned, added to the weights of another one that has learned nothing: the same spikes."""
    region, other = build(EVERY), build(EVERY)
    _, learned = run(region, 10, 1)
    untaught = learned | {name: torch.zeros_like(learned[name]) for name in region.learned}
    for name in region.learned:
        layer, source, _ = name.split(".")
        group, reads = other.parameter_groups()[layer], region.config.layers[layer].reads
        projection = group.recurrent if source == "recurrent" else group.projections[reads.index(source)]
        projection.weight += to_grid(learned[name][0], 14)
    told = inputs(region, 99, 1)
    assert torch.equal(region.step(told, learned)[0]["rate"], other.step(told, untaught)[0]["rate"])


def off(value: Mapping[str, Any]) -> dict[str, Any]:
    """The same network, whose rules have a learning rate of 0."""
    layers = {name: {**layer, "synapses": {}} for name, layer in value["layers"].items()}
    for name, layer in value["layers"].items():
        for key, synapses in layer.get("synapses", {}).items():
            learns = [{**rule, "learning_rate": 0} for rule in synapses.get("learns", [])]
            layers[name]["synapses"][key] = {**synapses, "learns": learns}
    return {**value, "layers": layers}


def test_with_rates_of_0_it_does_what_the_plain_network_does_and_weights_are_exchanged(tmp_path: Path) -> None:
    """Step by step, as its recurrent synapses could learn, it gives the spikes of the engine."""
    value = off(EVERY)
    for layer in value["layers"].values():
        for synapses in layer["synapses"].values():
            synapses.pop("fan_in", None)
            synapses.pop("sign", None)
            for rule in synapses["learns"]:
                rule.pop("feedback", None)
    value["layers"]["purkinje"]["synapses"]["granule"]["bounds"] = "-1..1"
    plain = {name: {k: v for k, v in layer.items() if k != "synapses"} for name, layer in value["layers"].items()}
    config = read_plugged(
        "region",
        {"type": "spiking_network", "carry": "always", "layers": plain, **{k: EVERY[k] for k in ("inputs", "outputs")}},
        Registry(),
    )
    network = Network(config, CLOCK, torch.Generator().manual_seed(5))
    save_weights(network, tmp_path / "net.safetensors", {}, bits=10)
    load_weights(network, tmp_path / "net.safetensors")
    region = build(value)
    load_weights(region, tmp_path / "net.safetensors")
    found, _ = run(region, 5, 2)
    state, wanted = network.init_state(2), []
    with torch.no_grad():
        for window in range(5):
            told = {name: x for name, x in inputs(region, window, 2).items() if name in network.input_ports}
            outputs, state = network.step(told, state)
            wanted.append(outputs["rate"])
    assert found.sum() > 0
    assert torch.equal(found, torch.cat(wanted))


def test_it_can_be_trained_before_it_learns() -> None:
    """Gradients reach the weights of all layers, as in the plain network."""
    region = build(EVERY)
    outputs, _ = region.step(inputs(region, 0, 2), region.init_state(2))
    outputs["rate"].sum().backward()
    for name, parameter in region.named_parameters():
        assert parameter.grad is not None and parameter.grad.abs().sum() > 0, name


def test_synapses_of_a_gain_of_their_own_are_scaled_by_it_and_no_others_are() -> None:
    """The same draws: those of twice the gain are twice as strong, recurrent ones too."""
    value = changed("layers.hidden.synapses.cue.gain", 1.4)
    value["layers"]["hidden"]["synapses"]["recurrent"]["gain"] = 1.0
    before, after = (PlasticNetwork(read(v), CLOCK, torch.Generator().manual_seed(1)) for v in (EVERY, value))
    scaled = {"layers.layer_hidden.projections.0.weight", "layers.layer_hidden.recurrent.weight"}
    found = dict(after.named_parameters())
    assert scaled < found.keys()
    for name, weight in before.named_parameters():
        torch.testing.assert_close(found[name], weight * (2 if name in scaled else 1), rtol=1e-6, atol=0)


def changed(path: str, value: Any) -> dict[str, Any]:
    """The network with another value at a path, or without it."""
    copy = yaml.safe_load(yaml.safe_dump(EVERY))
    *way, last = path.split(".")
    at = copy
    for part in way:
        at = at[int(part)] if isinstance(at, list) else at[part]
    if value is None:
        del at[last]
    else:
        at[int(last) if isinstance(at, list) else last] = value
    return copy


HIDDEN, PURKINJE = "layers.hidden.synapses", "layers.purkinje.synapses"


@pytest.mark.parametrize(
    ("path", "value", "at", "reason"),
    [
        (f"{HIDDEN}.recurrent.bounds", "0.3..0.3", f"{HIDDEN}.recurrent.bounds", "does not rise"),
        (f"{HIDDEN}.recurrent.bounds", None, f"{HIDDEN}.recurrent", "say between which weights"),
        (f"{HIDDEN}.granule.bounds", "0..1", f"{HIDDEN}.granule", "are for synapses that learn"),
        (f"{PURKINJE}.granule.bounds", "-1..1", f"{PURKINJE}.granule", "weights of the other sign"),
        (f"{HIDDEN}.recurrent.fan_in", 3, f"{HIDDEN}.recurrent.fan_in", "hear all others"),
        (f"{HIDDEN}.cue.fan_in", 13, f"{HIDDEN}.cue.fan_in", "`cue` has 12 neurons"),
        (f"{HIDDEN}.noise", {"fan_in": 2}, f"{HIDDEN}.noise", "has no synapses from `noise`"),
        ("layers.hidden.recurrent", False, f"{HIDDEN}.recurrent", "has no synapses from `recurrent`"),
        ("layers.hidden.reads", ["cue", "granule", "cue"], f"{HIDDEN}.cue", "more than once"),
        (
            "layers.hidden.neuron",
            "spiking_neural_unit",
            f"{HIDDEN}.cue.learns.0.type",
            "needs the potential, the decay and the surrogate",
        ),
        (
            f"{HIDDEN}.recurrent.learns.0.tau_y",
            "0.5 ms",
            f"{HIDDEN}.recurrent.learns.0.tau_y",
            "shorter than a spike step of 1 ms",
        ),
        (
            f"{PURKINJE}.hidden.learns.0.eligibility",
            "10 us",
            f"{PURKINJE}.hidden.learns.0.eligibility",
            "shorter than a spike step",
        ),
        (f"{PURKINJE}.hidden.learns.0.modulator", None, f"{PURKINJE}.hidden.learns.0", "waits for a modulator"),
        (
            f"{PURKINJE}.hidden.learns.0.modulator",
            "rewrad",
            f"{PURKINJE}.hidden.learns.0.modulator",
            "did you mean `reward`",
        ),
        (f"{PURKINJE}.hidden.learns.0", "supervise", f"{PURKINJE}.hidden.learns.0", "is a phase of training"),
        (
            f"{PURKINJE}.hidden.learns.0",
            "pear_stdp",
            f"{PURKINJE}.hidden.learns.0.type",
            "did you mean `core.pair_stdp`",
        ),
        ("modulators.error.width", 4, f"{PURKINJE}.granule.learns.0.feedback", "cannot be divided into 4"),
        ("modulators.pain", {}, "modulators.pain", "no rule names it"),
        ("modulators.reward.unit", "mNN", "", "not a unit"),
        ("carry", "never", "carry", "must be 'always'"),
    ],
)
def test_misuse_is_refused_with_its_place_and_reason(path: str, value: object, at: str, reason: str) -> None:
    with pytest.raises(ConfigError) as refused:
        checked_ports(read(changed(path, value)), CLOCK)
    found = {".".join(map(str, fault.path)): fault.message for fault in refused.value.faults}
    assert reason in found.get(at, "nothing there")


TRACKER = yaml.safe_load("""
type: plastic_network
inputs: {cue: {unit: "1", range: 0..1, code: {type: gaussian_receptive_fields, neurons: 20}}}
outputs: {rate: {unit: Hz, range: 0..1000 Hz, code: {type: population_uniform, neurons: 10}, width: 2}}
modulators: {error: {unit: Hz, width: 2}}
layers:
  hidden:
    neurons: 40
    reads: [cue]
    recurrent: true
    neuron: {type: lif, decay: 0.8}
    synapses:
      cue: &random
        bounds: -3..3
        learns: [{type: eprop, modulator: error, learning_rate: 2.0e-7, feedback: random}]
      recurrent: *random
  output:
    neurons: 20
    reads: [hidden]
    neuron: {type: lif, decay: 0.8}
    synapses:
      hidden: {bounds: -3..3, learns: [{type: eprop, modulator: error, learning_rate: 2.0e-6}]}
""")


def test_eprop_teaches_a_recurrent_network_on_line() -> None:
    """Two rates as functions of a cue, by the error of the window before, which had the same cue."""
    ends = []
    for seed in (0, 1):
        region = build(TRACKER, seed)
        code, rate = region.input_ports["cue"].code, region.output_ports["rate"].code
        assert code is not None and rate is not None
        generator = torch.Generator().manual_seed(seed)
        state, errors = region.init_state(1), []
        for _ in range(120):
            cue = torch.rand(1, 1, generator=generator)
            wanted = torch.cat([100 + 300 * cue, 400 - 300 * cue.square()], dim=1)
            error = torch.zeros(1, 2)
            for _ in range(2):
                with torch.no_grad():
                    outputs, state = region.step({"cue": code.encode(cue, 50, generator), "error": error}, state)
                error = wanted - rate.decode(outputs["rate"])
            errors.append(error.abs().mean())
        ends.append((float(torch.stack(errors[:10]).mean()), float(torch.stack(errors[-20:]).mean())))
    assert all(after < before / 3 for before, after in ends)
