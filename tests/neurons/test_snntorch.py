"""Neurons of snnTorch as ours: the same spikes and gradients, and none of its state."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import snntorch
import torch
from pydantic import ValidationError
from safetensors.torch import load_file, save_file
from snntorch import surrogate, utils
from torch import Tensor

from neurorobo.clock import Clock
from neurorobo.config.plugged_reader import validation_context
from neurorobo.engine import Layer
from neurorobo.neurons.snntorch_neuron import STATES, SnnTorchNeuron
from neurorobo.neurons.snntorch_neuron_config import SnnTorchNeuronConfig
from neurorobo.plugins import Registry
from neurorobo.regions.feedforward_config import FeedforwardConfig
from neurorobo.synapses import Dense
from neurorobo.testing import check_region

STEPS, BATCH, SOURCES, NEURONS = 30, 4, 20, 10
MODELS: dict[str, Callable[[], Any]] = {
    "Leaky": lambda: snntorch.Leaky(beta=0.9),
    "Leaky, to zero, at once": lambda: snntorch.Leaky(beta=0.8, reset_mechanism="zero", reset_delay=False),
    "Leaky, each its own": lambda: snntorch.Leaky(
        beta=torch.linspace(0.5, 0.9, NEURONS),
        threshold=torch.linspace(0.5, 1, NEURONS),
        spike_grad=surrogate.fast_sigmoid(slope=10),
    ),
    "Leaky, no reset": lambda: snntorch.Leaky(beta=0.5, reset_mechanism="none"),
    "Lapicque": lambda: snntorch.Lapicque(R=1, C=2, time_step=0.5),
    "Synaptic": lambda: snntorch.Synaptic(alpha=0.5, beta=0.8, spike_grad=surrogate.fast_sigmoid()),
    "Synaptic, to zero": lambda: snntorch.Synaptic(alpha=0.5, beta=0.8, reset_mechanism="zero", reset_delay=False),
    "Alpha": lambda: snntorch.Alpha(alpha=0.8, beta=0.5),
}
models = pytest.mark.parametrize("build", MODELS.values(), ids=MODELS)


def layer(neuron: SnnTorchNeuron, *, recurrent: bool = False) -> Layer:
    generator = torch.Generator().manual_seed(1)
    own = Dense(NEURONS, NEURONS, generator, gain=0.5) if recurrent else None
    return Layer([Dense(SOURCES, NEURONS, generator, gain=2.0)], neuron, own)


def spikes(steps: int = STEPS, batch: int = BATCH, seed: int = 2) -> Tensor:
    return (torch.rand(steps, batch, SOURCES, generator=torch.Generator().manual_seed(seed)) < 0.3).float()


def their_loop(model: Any, weight: Tensor, inputs: Tensor) -> Tensor:
    """A loop over time as its tutorials have it, which passes the state in and out."""
    state = [torch.zeros(inputs.shape[1], NEURONS) for _ in STATES[type(model).__name__]]
    fired = []
    for now in inputs:
        out, *state = model(now @ weight.t(), *state)
        fired.append(out)
    return torch.stack(fired)


@models
def test_spikes_and_gradients_are_those_of_its_own_loop(build: Callable[[], Any]) -> None:
    ours = layer(SnnTorchNeuron(build()))
    weight = ours.get_parameter("projections.0.weight")
    theirs = weight.detach().clone().requires_grad_()
    of_spikes = torch.randn(STEPS, BATCH, NEURONS, generator=torch.Generator().manual_seed(3))
    found, _ = ours([spikes()])
    expected = their_loop(build(), theirs, spikes())
    assert torch.equal(found, expected)
    assert 0.02 < expected.mean() < 0.98
    (found * of_spikes).sum().backward()
    (expected * of_spikes).sum().backward()
    assert weight.grad is not None and theirs.grad is not None
    assert theirs.grad.abs().max() > 0
    assert torch.allclose(weight.grad, theirs.grad, rtol=1e-4, atol=1e-5 * float(theirs.grad.abs().max()))


@models
def test_a_window_may_be_cut_and_its_state_saved_and_loaded(build: Callable[[], Any], tmp_path: Path) -> None:
    """Into a layer that is built anew; snnTorch's own state is no part of its state_dict."""
    with torch.no_grad():
        whole, last = layer(SnnTorchNeuron(build()), recurrent=True)([spikes()])
        first, state = layer(SnnTorchNeuron(build()), recurrent=True)([spikes()[:12]])
        save_file({"state": state}, tmp_path / "state.safetensors")
        again = load_file(tmp_path / "state.safetensors")["state"]
        second, end = layer(SnnTorchNeuron(build()), recurrent=True)([spikes()[12:]], again)
    assert torch.equal(torch.cat([first, second]), whole)
    assert torch.equal(end, last)


@models
def test_some_of_a_batch_start_anew(build: Callable[[], Any]) -> None:
    ours = layer(SnnTorchNeuron(build()))
    with torch.no_grad():
        _, state = ours([spikes(seed=4)])
        restarts = torch.tensor([True, False, True, False])
        mixed = torch.where(restarts[:, None], ours.at_rest(BATCH), state)
        found, _ = ours([spikes()], mixed)
        fresh, _ = ours([spikes()])
        carried, _ = ours([spikes()], state)
    assert torch.equal(found[:, restarts], fresh[:, restarts])
    assert torch.equal(found[:, ~restarts], carried[:, ~restarts])
    assert not torch.equal(fresh, carried)


@models
def test_two_networks_of_one_neuron_run_side_by_side(build: Callable[[], Any]) -> None:
    """In turns, on batches of different sizes, and whatever becomes of snnTorch's own neurons in between."""
    shared = build()
    one, other = layer(SnnTorchNeuron(shared)), layer(SnnTorchNeuron(shared))
    with torch.no_grad():
        expected, _ = one([spikes()])
        found, mine, yours = [], one.at_rest(BATCH), other.at_rest(1)
        for now in spikes().split(1):
            fired, mine = one([now], mine)
            _, yours = other([spikes(1, 1)], yours)
            utils.reset(torch.nn.Sequential(shared))
            found.append(fired)
    assert torch.equal(torch.cat(found), expected)


def hidden() -> Any:
    """A neuron of snnTorch that keeps its membrane to itself."""
    return snntorch.Leaky(beta=0.9, init_hidden=True)


def test_snntorch_itself_resets_too_much_and_too_little_and_does_not_save_its_state() -> None:
    """This test and the two below: what the page *Coming from snnTorch* says of version 1.0."""
    one, other, nested = (torch.nn.Sequential(module) for module in (hidden(), hidden(), torch.nn.Sequential(hidden())))
    for network in (other, nested):
        network(torch.ones(1, 3))
    assert not [name for name in other.state_dict() if name.endswith("mem")]
    utils.reset(nested)
    assert nested[0][0].mem.any()
    assert other[0].mem.any()
    utils.reset(one)
    assert not other[0].mem.any()


def test_snntorch_itself_keeps_the_graph_of_a_training_step() -> None:
    neuron, weight = hidden(), torch.ones(1, requires_grad=True)
    neuron(weight * torch.ones(1, 3)).sum().backward()
    with pytest.raises(RuntimeError, match="backward through the graph a second time"):
        neuron(weight * torch.ones(1, 3)).sum().backward()


def test_the_sigmoid_of_snntorch_has_no_derivative_far_below_the_threshold() -> None:
    distance = torch.tensor([-1.0, -4.0], requires_grad=True)
    surrogate.sigmoid()(distance).sum().backward()
    assert distance.grad is not None
    assert distance.grad.isnan().tolist() == [False, True]


@models
def test_it_leaves_the_neuron_as_it_was_and_keeps_nothing(build: Callable[[], Any]) -> None:
    given = build()
    given.mem = torch.full((2, 3), 0.25, requires_grad=True) * 2  # left by a training step
    neuron = SnnTorchNeuron(given)
    fired, _ = layer(neuron)([spikes()])
    fired.sum().backward()
    fired, _ = layer(neuron)([spikes()])
    fired.sum().backward()  # a graph that had been kept would be gone by now
    assert torch.equal(given.mem, torch.full((2, 3), 0.5))
    assert all(getattr(neuron._neuron, name).numel() == 0 for name in STATES[type(given).__name__])


def test_neurons_of_a_file_do_not_stay_in_its_list() -> None:
    before = list(snntorch.SpikingNeuron.instances)
    SnnTorchNeuronConfig.model_validate({"beta": 0.9}).build(10**6)
    assert len(snntorch.SpikingNeuron.instances) == len(before)


@pytest.mark.parametrize(
    ("settings", "build"),
    [
        ({"class": "Leaky", "beta": 0.9}, lambda: snntorch.Leaky(beta=0.9)),
        ({"beta": 0.9, "spike_grad": "atan", "slope": 5}, lambda: snntorch.Leaky(0.9, spike_grad=surrogate.atan(5))),
        (
            {"beta": 0.8, "threshold": 0.5, "reset_mechanism": "zero", "reset_delay": False},
            lambda: snntorch.Leaky(0.8, 0.5, reset_mechanism="zero", reset_delay=False),
        ),
        ({"class": "Lapicque", "beta": 0.9}, lambda: snntorch.Lapicque(beta=0.9)),
        (
            {"class": "Synaptic", "alpha": 0.7, "beta": 0.8, "spike_grad": "fast_sigmoid"},
            lambda: snntorch.Synaptic(0.7, 0.8, spike_grad=surrogate.fast_sigmoid()),
        ),
        ({"class": "Alpha", "alpha": 0.8, "beta": 0.5}, lambda: snntorch.Alpha(0.8, 0.5)),
    ],
)
def test_a_file_says_what_the_constructor_does(settings: dict[str, Any], build: Callable[[], Any]) -> None:
    found = []
    for neuron in (SnnTorchNeuronConfig.model_validate(settings).build(10**6), SnnTorchNeuron(build())):
        ours = layer(neuron)
        fired, _ = ours([spikes()])
        fired.sum().backward()
        found.append((fired, ours.get_parameter("projections.0.weight").grad))
    assert torch.equal(found[0][0], found[1][0]) and found[0][0].any()
    assert torch.equal(found[0][1], found[1][1])  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"class": "RLeaky", "beta": 0.9}, "its recurrent weights are the layer's here"),
        ({"class": "SLSTM", "beta": 0.9}, "it has weights of its own"),
        ({"class": "StateLeaky", "beta": 0.9}, "it takes a whole window at once"),
        ({"class": ["Leaky"], "beta": 0.9}, "Input should be 'Leaky'"),
        ({"class": "Leek", "beta": 0.9}, "Input should be 'Leaky', 'Lapicque', 'Synaptic' or 'Alpha'"),
        ({"class": "Synaptic", "beta": 0.9}, "Synaptic needs `alpha`"),
        ({"beta": 0.9, "alpha": 0.9}, "Leaky has no `alpha`"),
        ({"class": "Alpha", "alpha": 0.9, "beta": 0.8, "reset_delay": False}, "Alpha resets in the next step"),
        ({"beta": 1.5}, "less than or equal to 1"),
        ({"beta": 0.9, "learn_beta": True}, "Extra inputs are not permitted"),
    ],
)
def test_what_a_file_may_not_say(settings: dict[str, Any], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        SnnTorchNeuronConfig.model_validate(settings)


@pytest.mark.parametrize(
    ("build", "words"),
    [
        (
            lambda: snntorch.RLeaky(0.9, linear_features=3),
            "RLeaky cannot be a neuron of a layer: its recurrent weights",
        ),
        (lambda: snntorch.SLSTM(3, 3), "SLSTM cannot be a neuron of a layer: it has weights of its own"),
        (lambda: torch.nn.ReLU(), "ReLU cannot be a neuron of a layer: it is not known"),
        (lambda: snntorch.Leaky(0.9, learn_beta=True), "`beta` of snnTorch's Leaky would not be trained"),
        (lambda: snntorch.Leaky(0.9, learn_threshold=True), "`threshold` of snnTorch's Leaky would not be trained"),
        (lambda: snntorch.Leaky(0.9, init_hidden=True), "leave out `init_hidden`"),
        (lambda: snntorch.Leaky(0.9, graded_spikes_factor=2.0), "spikes are 0 or 1 here"),
    ],
)
def test_neurons_that_are_refused(build: Callable[[], Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        SnnTorchNeuron(build())


@pytest.mark.parametrize("neuron", [{"beta": 0.9}, {"class": "Alpha", "alpha": 0.8, "beta": 0.5}])
def test_a_region_of_such_neurons_conforms(neuron: dict[str, Any]) -> None:
    settings = {
        "inputs": {"force": {"unit": "mN", "range": "-1..1 mN"}},
        "outputs": {"speed": {"unit": "um/s", "range": "0..1 um/s"}},
        "neuron": {"type": "snntorch_neuron", **neuron},
        "carry": "always",
    }
    config = FeedforwardConfig.model_validate(settings, context=validation_context(Registry()))
    check_region(config, Clock({"control": 10**9}, 10**6, 20))
