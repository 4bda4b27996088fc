"""Layers: several projections onto one population, whose state is given and returned."""

from typing import Any

import pytest
import torch
from torch import Tensor

from neurorobo.engine import Layer
from neurorobo.engine import layer as layer_module
from neurorobo.neurons import LIF, Surrogate
from neurorobo.regions.weights import to_grid
from neurorobo.synapses import Dense, FanIn
from tests.engine.paths import engine


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def spikes(steps: int, batch: int, neurons: int, rate: float = 0.3, seed: int = 1) -> Tensor:
    return (torch.rand(steps, batch, neurons, generator=generator(seed)) < rate).float()


def test_a_layer_adds_up_its_projections_and_its_own_last_spikes() -> None:
    a, b = Dense(6, 5, generator(1)), FanIn(8, 5, 3, generator(2))
    own = Dense(5, 5, generator(3))
    layer = Layer([a, b], LIF(threshold=0.4, decay=0.3), own, trainable_threshold=True)
    from_a, from_b = spikes(9, 2, 6, seed=4), spikes(9, 2, 8, seed=5)
    found, last = layer([from_a, from_b], layer.at_rest(2))

    potential, fired = torch.zeros(2, 5), torch.zeros(2, 5)
    for t in range(9):
        current = from_a[t] @ a.matrix().t() + from_b[t] @ b.matrix().t() + fired @ own.matrix().t()
        potential = current + 0.3 * potential * (1 - fired)
        fired = (potential >= 0.4).float()
        assert torch.equal(found[t], fired)
    assert torch.allclose(last, potential)
    assert 0.1 < found.mean() < 0.9


def test_a_layer_leaves_its_inputs_and_its_state_alone_and_trains_all_it_has() -> None:
    layer = Layer([Dense(6, 5, generator())], LIF(), Dense(5, 5, generator(1)), trainable_threshold=True)
    inputs, state = spikes(9, 2, 6), torch.rand(2, 5, generator=generator(2))
    given_inputs, given_state = inputs.clone(), state.clone()
    found, potential = layer([inputs], state)
    assert torch.equal(inputs, given_inputs)
    assert torch.equal(state, given_state)
    (found.sum() + potential.sum()).backward()
    assert {name for name, parameter in layer.named_parameters() if parameter.grad is not None} == {
        "projections.0.weight",
        "recurrent.weight",
        "threshold",
    }


def test_without_input_a_layer_at_rest_stays_silent() -> None:
    layer = Layer([Dense(6, 5, generator())], LIF(), Dense(5, 5, generator(1)))
    found, potential = layer([torch.zeros(50, 3, 6)], layer.at_rest(3))
    assert found.sum() == 0
    assert potential.abs().sum() == 0


def grid_layer(sources: int, targets: int) -> Layer:
    """A recurrent layer whose weights are on the grid of shipped weights."""
    layer = Layer([Dense(sources, targets, generator(), gain=2.0)], LIF(), Dense(targets, targets, generator(1)))
    layer.load_state_dict({name: to_grid(weight) for name, weight in layer.state_dict().items()})
    return layer


@torch.no_grad()
def test_on_the_grid_a_run_is_the_same_alone_and_in_a_batch_of_64_bit_for_bit() -> None:
    layer = grid_layer(900, 83)
    inputs = spikes(50, 64, 900)
    together, potentials = layer([inputs], layer.at_rest(64))
    assert 0.05 < together.mean() < 0.95
    for i in (0, 1, 31, 63):
        alone, potential = layer([inputs[:, i : i + 1]], layer.at_rest(1))
        assert torch.equal(alone[:, 0], together[:, i])
        assert torch.equal(potential[0], potentials[i])


@torch.no_grad()
def test_on_the_grid_the_order_of_summation_does_not_matter() -> None:
    layer = grid_layer(900, 83)
    (projection,) = layer.projections
    inputs, order = spikes(50, 4, 900), torch.randperm(900, generator=generator(7))
    currents = projection(inputs)
    before, _ = layer([inputs], layer.at_rest(4))
    off_the_grid = torch.nn.functional.linear(inputs, projection.weight / 3)
    off_the_grid_permuted = torch.nn.functional.linear(inputs[..., order], projection.weight[:, order] / 3)
    projection.weight.copy_(projection.weight[:, order])
    assert torch.equal(projection(inputs[..., order]), currents)
    after, _ = layer([inputs[..., order]], layer.at_rest(4))
    assert torch.equal(after, before)
    assert not torch.equal(off_the_grid_permuted, off_the_grid)  # it is the grid that does it


@pytest.mark.parametrize(
    ("projections", "recurrent"),
    [
        ([Dense(3, 4, generator()), Dense(3, 5, generator())], None),
        ([Dense(3, 4, generator())], Dense(5, 5, generator())),
        ([Dense(3, 4, generator())], Dense(3, 4, generator())),
    ],
)
def test_projections_that_disagree_on_the_size_are_refused(projections: list[Dense], recurrent: Dense | None) -> None:
    with pytest.raises(ValueError, match="must agree on its size"):
        Layer(projections, LIF(), recurrent)


class Stepped(LIF):
    """The same neuron, but as a model of its own: the layer steps it one by one."""


@pytest.mark.parametrize("recurrent", [False, True])
@pytest.mark.parametrize("neuron_settings", [{}, {"reset_gradient": "detached"}, {"rectify": True}])
def test_any_neuron_runs_as_lif_neurons_do_forwards_and_backwards(
    recurrent: bool, neuron_settings: dict[str, Any]
) -> None:
    found = []
    for model in (LIF, Stepped):
        neuron = model(decay=0.3, surrogate=Surrogate("arctan"), **neuron_settings)
        own = Dense(5, 5, generator(1)) if recurrent else None
        layer = Layer([Dense(6, 5, generator(), gain=2.0)], neuron, own)
        fired, state = layer([spikes(4, 2, 6)], layer.at_rest(2))
        more, state = layer([spikes(5, 2, 6, seed=2)], state)  # the state carries the last spikes too
        (torch.cat([fired, more]) * torch.randn(9, 2, 5, generator=generator(3))).sum().backward()
        found.append((torch.cat([fired, more]), state[:, :5], [weight.grad for weight in layer.parameters()]))
    (fast, potential, gradients), (slow, their_potential, their_gradients) = found
    assert torch.equal(fast, slow)
    assert 0.1 < fast.mean() < 0.9
    assert torch.allclose(potential, their_potential, atol=1e-6)
    for gradient, theirs in zip(gradients, their_gradients, strict=True):
        assert torch.allclose(gradient, theirs, rtol=1e-4, atol=1e-5)


class Careless(LIF):
    """Returns the spikes of one neuron too few."""

    def step(self, current: Tensor, potential: Tensor) -> tuple[Tensor, Tensor]:
        fired, potential = super().step(current, potential)
        return fired[:, 1:], potential


def test_a_neuron_that_returns_spikes_of_another_size_is_named() -> None:
    layer = Layer([Dense(6, 5, generator())], Careless())
    with pytest.raises(ValueError, match=r"Careless.step must return spikes of \(2, 5\).*not \(2, 4\)"):
        layer([spikes(3, 2, 6)], layer.at_rest(2))


def test_trained_thresholds_stay_positive() -> None:
    layer = Layer([Dense(6, 3, generator())], LIF(), trainable_threshold=True)
    assert layer.threshold is not None
    weight = layer.projections[0].weight.clone()  # type: ignore[operator]
    with torch.no_grad():
        layer.threshold.copy_(torch.tensor([-0.3, 0.01, 0.4]))
    layer.constrain()
    assert layer.threshold.tolist() == pytest.approx([0.05, 0.05, 0.4])
    assert torch.equal(layer.projections[0].weight, weight)


@pytest.mark.parametrize(
    ("neuron", "words"), [(Stepped(), "only thresholds of LIF neurons"), (LIF(threshold=0.01), "starts at 0.05")]
)
def test_thresholds_that_cannot_be_trained_are_refused(neuron: LIF, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        Layer([Dense(6, 3, generator())], neuron, trainable_threshold=True)


@pytest.mark.parametrize("model", [LIF, Stepped])
def test_sizes_that_do_not_fit_are_refused_before_anything_is_broadcast(model: type[LIF]) -> None:
    layer = Layer([Dense(3, 4, generator()), Dense(2, 4, generator())], model())
    with pytest.raises(ValueError, match=r"agree in steps and batch, got \[\(5, 1\), \(5, 3\)\]"):
        layer([spikes(5, 3, 3), spikes(5, 1, 2)], layer.at_rest(3))
    with pytest.raises(ValueError, match="of 2 sources was given the spikes of 1"):
        layer([spikes(5, 3, 3), spikes(5, 3, 1)], layer.at_rest(3))
    with pytest.raises(ValueError, match=r"of a batch of 1, the current of 3|\(1, 4\).*the current of \(3, 4\)"):
        layer([spikes(5, 3, 3), spikes(5, 3, 2)], layer.at_rest(1))


def test_an_input_too_many_is_refused() -> None:
    layer = Layer([Dense(3, 4, generator())], LIF())
    with pytest.raises(ValueError):
        layer([spikes(5, 1, 3), spikes(5, 1, 3)], layer.at_rest(1))


@pytest.mark.parametrize("model", [LIF, Stepped])
@torch.no_grad()
def test_a_large_batch_runs_in_parts_as_it_does_in_one(model: type[LIF], monkeypatch: pytest.MonkeyPatch) -> None:
    layer = Layer([Dense(30, 20, generator(), gain=2.0)], model(), Dense(20, 20, generator()))
    for parameter in layer.parameters():
        parameter.copy_(to_grid(parameter, 12))
    given, state = spikes(9, 7, 30), layer.at_rest(7)
    with engine("portable"):
        whole = layer([given], state)
        monkeypatch.setattr(layer_module, "CURRENTS_AT_ONCE", 3 * 9 * 20)  # batches of 3, 3 and 1
        parts = layer([given], state)
        assert all(torch.equal(found, expected) for found, expected in zip(parts, whole, strict=True))
        given[4, 5, 6] = 2
        with pytest.raises(ValueError, match=r"got 2 from source 6 \(step 4, batch element 5\)"):
            layer([given], state)
        with pytest.raises(ValueError, match=r"the (potential|state) is of"):
            layer([given.clamp(max=1)], layer.at_rest(6))
