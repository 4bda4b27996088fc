"""Neurons other than LIF on the native path: the bits of their own steps, autograd's gradients, pieces and circuits."""

from collections.abc import Iterator

import pytest
import torch
from torch import Tensor

from neurorobo.engine import Circuit, Fired, Layer, run_neurons, run_steps
from neurorobo.engine.models import KINDS, native_model
from neurorobo.neurons import LIF, Neuron, Surrogate
from neurorobo.neurons.bidimensional import AdEx, Izhikevich
from neurorobo.neurons.generalized_lif import GeneralizedLIF
from neurorobo.neurons.soft_unit import SoftUnit
from neurorobo.regions.weights import to_grid
from neurorobo.synapses import Dense, FanIn
from tests.engine.paths import engine, instruction_sets, needs_native

pytestmark = needs_native()

SOURCES = 70
SMOOTH = Surrogate("fast_sigmoid", 0.7)
MODELS: dict[str, tuple[Neuron, float]] = {
    "leaky": (GeneralizedLIF(decay=0.9, input_gain=0.3, surrogate=SMOOTH), 3.0),
    "leaky, reset by its threshold": (GeneralizedLIF(decay=0.8, reset="subtract", surrogate=SMOOTH), 1.5),
    "leaky, reset without gradient": (GeneralizedLIF(decay=0.8, reset_gradient="detached"), 1.5),
    "perfect": (GeneralizedLIF(decay=1.0, reset="subtract", surrogate=Surrogate("arctan", 0.5)), 0.7),
    "synaptic": (GeneralizedLIF(decay=0.9, input_gain=0.1, synapse_decay=0.7, surrogate=SMOOTH), 3.0),
    "adaptive": (GeneralizedLIF(decay=0.9, adaptation=0.3, adaptation_decay=0.95, surrogate=SMOOTH), 2.0),
    "synaptic and adaptive, detached": (
        GeneralizedLIF(
            0.7, 0.9, 0.2, 0.8, 0.2, 0.9, "subtract", Surrogate("triangular", 1.3), reset_gradient="detached"
        ),
        3.0,
    ),
    "Izhikevich, regular": (Izhikevich(), 15.0),
    "Izhikevich, chattering": (Izhikevich(c=-50, d=2, substeps=4, input_gain=2.0), 8.0),
    "AdEx": (AdEx(), 2500.0),
    "AdEx, another": (AdEx(a_nS=-0.5, b_pA=7, reset_mV=-46, time_constant_ms=100, substeps=7, input_gain=20.0), 60.0),
    "soft": (SoftUnit(threshold=0.3, decay=0.6, slope=2.0), 1.5),
}
models = pytest.mark.parametrize(("neuron", "gain"), MODELS.values(), ids=MODELS)
spiking = pytest.mark.parametrize(
    ("neuron", "gain"), [each for each in MODELS.values() if not isinstance(each[0], SoftUnit)]
)


@pytest.fixture(autouse=True, params=instruction_sets())
def native_path(request: pytest.FixtureRequest) -> Iterator[str]:
    with engine("native", request.param):
        yield request.param


def spikes(steps: int = 40, batch: int = 3, seed: int = 1) -> Tensor:
    return (torch.rand(steps, batch, SOURCES, generator=torch.Generator().manual_seed(seed)) < 0.3).float()


def build(neuron: Neuron, gain: float, *, recurrent: bool = False, neurons: int = 150) -> Layer:
    """A dense projection and a fan-in, of weights whose sums are exact."""
    generator = torch.Generator().manual_seed(0)
    own = Dense(neurons, neurons, generator, gain=0.3 * gain) if recurrent else None
    projections = [Dense(SOURCES, neurons, generator, gain=gain), FanIn(SOURCES, neurons, 5, generator, gain=gain)]
    layer = Layer(projections, neuron, own)
    with torch.no_grad():
        for parameter in layer.parameters():
            parameter.copy_(to_grid(parameter, 8))
    return layer


def a_state(layer: Layer, batch: int = 3) -> Tensor:
    """What a window leaves behind."""
    with torch.no_grad():
        return layer([spikes(20, batch, seed=7)] * 2, layer.at_rest(batch))[1]


def test_the_models_are_those_of_the_core() -> None:
    assert {type(neuron) for neuron, _ in MODELS.values()} == set(KINDS)
    assert native_model(LIF()) is None


@pytest.mark.parametrize("recurrent", [False, True])
@models
def test_both_paths_give_the_same_bits(neuron: Neuron, gain: float, recurrent: bool) -> None:
    layer, inputs = build(neuron, gain, recurrent=recurrent), [spikes()] * 2
    for state in (None, a_state(layer)):
        with torch.no_grad():
            fired, after = layer(inputs, state)
        trained, trained_after = layer(inputs, state)
        with engine("portable"), torch.no_grad():
            wanted, wanted_after = layer(inputs, state)
        assert torch.equal(fired, wanted)
        assert torch.equal(after, wanted_after)
        assert torch.equal(trained, wanted)
        assert torch.equal(trained_after, wanted_after)
        if not isinstance(neuron, SoftUnit):
            assert 0.003 < fired.mean() < 0.6


@pytest.mark.parametrize("recurrent", [False, True])
@models
def test_gradients_are_those_of_autograd(neuron: Neuron, gain: float, recurrent: bool) -> None:
    layer = build(neuron, gain, recurrent=recurrent)
    state, given = a_state(layer), spikes()
    generator = torch.Generator().manual_seed(3)

    def gradients() -> list[Tensor]:
        layer.zero_grad()
        inputs, before = given.clone().requires_grad_(), state.clone().requires_grad_()
        fired, after = layer([inputs, given], before)
        scale = torch.rand(fired.shape, generator=generator.manual_seed(4))
        of_state = torch.rand(after.shape, generator=generator)
        ((fired * scale).sum() + (after * of_state).sum()).backward()
        assert inputs.grad is not None and before.grad is not None
        return [inputs.grad, before.grad, *(p.grad for p in layer.parameters() if p.grad is not None)]

    ours = gradients()
    with engine("portable"):
        theirs = gradients()
    assert len(ours) == len(theirs) == 4 + recurrent
    for mine, other in zip(ours, theirs, strict=True):
        assert other.abs().max() > 0
        torch.testing.assert_close(mine, other, rtol=1e-4, atol=1e-5 * float(other.abs().max()))


@models
def test_a_window_in_pieces_is_the_window(neuron: Neuron, gain: float) -> None:
    layer, whole = build(neuron, gain, recurrent=not isinstance(neuron, SoftUnit)), spikes()
    with torch.no_grad():
        fired, after = layer([whole] * 2)
        state, pieces = layer.at_rest(whole.shape[1]), []
        for piece in whole.split([1, 7, 32]):
            some, state = layer([piece] * 2, state)
            pieces.append(some)
    assert torch.equal(torch.cat(pieces), fired)
    assert torch.equal(state, after)


@models
def test_a_batch_is_its_members(neuron: Neuron, gain: float) -> None:
    layer, given = build(neuron, gain, recurrent=not isinstance(neuron, SoftUnit)), spikes(batch=20)
    with torch.no_grad():
        together, _ = layer([given] * 2)
        for member in (0, 19):
            alone, _ = layer([given[:, member : member + 1].contiguous()] * 2)
            assert torch.equal(alone[:, 0], together[:, member])


@spiking
def test_a_circuit_runs_them_in_one_call(neuron: Neuron, gain: float) -> None:
    first, second = build(neuron, gain, recurrent=True), build(neuron, gain)
    plain = Layer([Dense(150, 10, torch.Generator().manual_seed(5), gain=2.0)], LIF())
    with torch.no_grad():
        plain.projections[0].weight.copy_(to_grid(plain.projections[0].weight, 8))  # type: ignore[operator,union-attr]
    layers = {"first": (first, ["in", "in"]), "second": (second, ["in", "in"]), "plain": (plain, ["second"])}
    circuit, given = Circuit(["in"], layers), spikes()
    heard: dict[str, Tensor] = {}

    class Probe:
        def __call__(self, layer: str, spikes: Tensor) -> None:
            raise AssertionError("they came one by one")

        def hear(self, layer: str, fired: Fired) -> None:
            heard[layer] = fired.counts()

    state = {"first": a_state(first), "second": second.at_rest(3)}
    with torch.no_grad():
        for _ in range(2):
            fired, after = circuit({"in": given}, state, ["first", "plain"], Probe())
        alone, alone_after = first([given] * 2, state["first"])
        other, other_after = second([given] * 2)
        last, _ = plain([other])
    assert torch.equal(fired["first"], alone) and torch.equal(fired["plain"], last)
    assert torch.equal(after["first"], alone_after) and torch.equal(after["second"], other_after)
    assert heard["second"].tolist() == other.sum((0, 2)).tolist()


def test_layers_read_the_numbers_of_soft_units_that_are_told_so() -> None:
    soft = build(*MODELS["soft"])
    reader = Layer(
        [Dense(150, 30, torch.Generator().manual_seed(2), gain=1.0), Dense(SOURCES, 30, torch.Generator())], LIF()
    )
    given = spikes()
    with pytest.raises(ValueError, match="spikes are 0 or 1"), torch.no_grad():
        reader([soft([given] * 2)[0], given])
    reader.projections[0].graded = True

    def gradients() -> tuple[Tensor, list[Tensor]]:
        for layer in (soft, reader):
            layer.zero_grad()
        fired, _ = reader([soft([given] * 2)[0], given])
        fired.sum().backward()
        return fired.detach(), [p.grad for layer in (soft, reader) for p in layer.parameters() if p.grad is not None]

    fired, ours = gradients()
    with torch.no_grad():
        assert torch.equal(reader([soft([given] * 2)[0], given])[0], fired)
    with engine("portable"):
        same, theirs = gradients()
    assert (fired == same).float().mean() > 0.999  # sums of numbers depend on their order
    assert 0.05 < fired.mean() < 0.9
    for mine, other in zip(ours, theirs, strict=True):
        torch.testing.assert_close(mine, other, rtol=1e-2, atol=1e-2 * float(other.abs().max()))


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_numbers_that_are_none_are_refused_by_their_place(native_path: str, value: float) -> None:
    reader = Layer([Dense(3, 2, torch.Generator())], LIF())
    reader.projections[0].graded = True
    given = torch.zeros(4, 2, 3)
    given[2, 1, 0] = value
    for path in ("native", "portable"):
        with engine(path), pytest.raises(ValueError, match=r"from source 0 \(step 2, batch element 1\)"):
            reader([given])


@spiking
def test_a_state_that_is_no_number_is_refused(neuron: Neuron, gain: float) -> None:
    layer = build(neuron, gain)
    state = layer.at_rest(3)
    state[1, 2] = float("nan")
    for path in ("native", "portable"):
        with engine(path), pytest.raises(ValueError, match=r"finite number, got nan at \[1, 2\]"):
            layer([spikes()] * 2, state)


def test_who_fired_last_is_told_by_lif_and_by_recurrent_layers() -> None:
    for neuron in (LIF(), GeneralizedLIF(decay=0.8)):
        layer = build(neuron, 1.5, recurrent=True)
        fired, after = layer([spikes()] * 2)
        assert torch.equal(layer.fired(after), fired[-1])
    with pytest.raises(ValueError, match="tells not who fired"):
        build(GeneralizedLIF(), 1.0).fired(torch.zeros(1, 150))


@pytest.mark.parametrize("recurrent", [False, True])
@models
def test_a_scan_of_currents_is_the_neurons_own_steps(neuron: Neuron, gain: float, recurrent: bool) -> None:
    layer = build(neuron, gain, recurrent=recurrent)
    state, weight = a_state(layer), None if layer.recurrent is None else layer.recurrent.matrix()
    with torch.no_grad():
        current = layer.projections[0](spikes())
        fired, after = run_neurons(current.clone(), state, neuron, None, weight)
        wanted, wanted_after = run_steps(current, state, neuron, weight)
    assert torch.equal(fired, wanted)
    assert torch.equal(after, wanted_after)


def transposed(tensor: Tensor) -> Tensor:
    """The same numbers, with the first dimension behind the last in memory."""
    return tensor.movedim(0, -1).contiguous().movedim(-1, 0)


@models
def test_tensors_may_lie_in_memory_in_any_order(neuron: Neuron, gain: float) -> None:
    layer = build(neuron, gain)
    before = a_state(layer)
    with torch.no_grad():
        current = layer.projections[0](spikes())
    scale = torch.rand(current.shape, generator=torch.Generator().manual_seed(4))

    def run(current: Tensor, state: Tensor, of_spikes: Tensor) -> tuple[Tensor, Tensor]:
        state.requires_grad_()
        fired, _ = run_neurons(current, state, neuron)
        return fired.detach(), torch.autograd.grad(fired, state, of_spikes)[0]

    wanted, gradient = run(current.clone(), before.clone(), scale)
    assert not any(transposed(tensor).is_contiguous() for tensor in (current, before, scale))
    for now, state, of_spikes in (
        (transposed(current), before.clone(), scale),
        (current.clone(), transposed(before), scale),
        (current.clone(), before.clone(), transposed(scale)),
    ):
        fired, same = run(now, state, of_spikes)
        assert torch.equal(fired, wanted)
        assert torch.equal(same, gradient)


@pytest.mark.parametrize("recurrent", [False, True])
@models
def test_the_gradient_that_comes_in_stays_as_it_is(neuron: Neuron, gain: float, recurrent: bool) -> None:
    layer = build(neuron, gain, recurrent=recurrent)
    state = layer.at_rest(1).requires_grad_()
    _, after = layer([spikes(batch=1)] * 2, state)
    given = torch.rand(after.shape, generator=torch.Generator().manual_seed(4))
    kept = given.clone()
    torch.autograd.grad(after, state, given)
    assert torch.equal(given, kept)


@models
def test_what_does_not_fit_the_neurons_is_refused(neuron: Neuron, gain: float) -> None:
    current, state = torch.zeros(2, 1, 3), neuron.at_rest(1, 3)
    recurrent_state = torch.cat([state, torch.zeros(1, 3)], dim=1)
    for path in ("native", "portable"):
        with engine(path):
            with pytest.raises(ValueError, match=r"weights of 3 neurons are of \(3, 3\), got \(2, 2\)"):
                run_neurons(current, recurrent_state, neuron, None, torch.zeros(2, 2))
            with pytest.raises(ValueError, match="only LIF neurons can be given thresholds"):
                run_neurons(current, state, neuron, torch.ones(3))


@pytest.mark.parametrize("recurrent", [False, True])
@models
def test_a_state_of_another_size_or_type_is_refused(neuron: Neuron, gain: float, recurrent: bool) -> None:
    layer = build(neuron, gain, recurrent=recurrent)
    state = layer.at_rest(3)
    variables = state.shape[1]
    for path in ("native", "portable"):
        with engine(path):
            for other in (state[:, :1], state[:, :-1], torch.cat([state, state], dim=1)):
                with pytest.raises(ValueError, match=rf"150 neurons .* is of \(3, {variables}\) .* got \(3, "):
                    layer([spikes()] * 2, other)
            with pytest.raises(ValueError, match=r"state of torch\.float64 does not go with a current"):
                layer([spikes()] * 2, state.double())


def test_a_potential_that_overflows_is_no_undefined_exponent() -> None:
    neuron = AdEx(input_gain=100.0)
    with torch.no_grad():
        fired, after = run_neurons(torch.full((2, 1, 3), -3e38), neuron.at_rest(1, 3), neuron)
    assert not fired.any()
    assert after[:, :3].isnan().all()
