"""Integrate-and-fire neurons by their time constants: responses and rates against closed forms, and other programs."""

import dataclasses
import math
from typing import Any, Literal

import pytest
import snntorch
import torch
from torch import Tensor

from neurorobo.neurons import Surrogate, just_above
from neurorobo.neurons.generalized_lif import GeneralizedLIF
from neurorobo.neurons.generalized_lif_config import (
    AdaptiveLIFConfig,
    ExactLIFConfig,
    IntegrateAndFireConfig,
    SynapticLIFConfig,
)
from tests.neurons.stepped import constant, intervals, run

MS = 1_000_000
Reset = Literal["zero", "subtract"]
resets = pytest.mark.parametrize("reset", ["zero", "subtract"])


@pytest.mark.parametrize("tau_ms", [2, 20, 70])
@pytest.mark.parametrize("step_us", [100, 500, 2000])
def test_exact_lif_fires_at_the_interval_of_continuous_time(tau_ms: int, step_us: int) -> None:
    """``T = tau ln(R I / (R I - threshold))``, rounded up to the grid of the steps; its f-I curve is 1 / T."""
    config = ExactLIFConfig(threshold=0.7, resistance=3.0, membrane_time_constant=f"{tau_ms} ms")
    strength = torch.linspace(1.05, 10, 200, dtype=torch.float64)  # in thresholds
    exact = tau_ms * 1000 / step_us * (strength / (strength - 1)).log()
    strength, exact = (each[((exact - exact.round()).abs() > 1e-6) & (exact < 250)] for each in (strength, exact))
    spikes, _ = run(config.build(step_us * 1000), (strength * 0.7 / 3.0).repeat(1000, 1))
    interval = exact.ceil().long()
    assert len(interval.unique()) > 1
    assert torch.equal(spikes.sum(0), 1000 // interval)
    for fired, steps in zip(spikes.T, interval.tolist(), strict=True):
        assert set(intervals(fired)) == {steps}


@pytest.mark.parametrize("step_us", [100, 500, 1000, 2000, 5000])
def test_exact_integration_of_a_constant_input_does_not_depend_on_the_step(step_us: int) -> None:
    """``U(t) = R I (1 - exp(-t / tau))`` and from there ``U(0) exp(-t / tau)``, to the last bits."""
    neuron = ExactLIFConfig(threshold=10, resistance=3.0, membrane_time_constant="20 ms").build(step_us * 1000)
    steps = 40_000 // step_us
    currents = torch.cat([constant(2.0, steps=steps), constant(0.0, steps=steps)])
    _, states = run(neuron, currents)
    t_ms = torch.arange(1, steps + 1).double() * (step_us / 1000)
    charge = 6 * (1 - (-t_ms / 20).exp())
    expected = torch.cat([charge, charge[-1] * (-t_ms / 20).exp()])
    assert torch.allclose(states[:, 0, 0], expected, rtol=1e-12)


def test_without_a_leak_the_rate_is_proportional_to_the_input_whatever_it_is() -> None:
    currents = torch.linspace(0.01, 1.0, 50).double() * 0.5
    neuron = IntegrateAndFireConfig(reset="subtract").build(MS)
    spikes, states = run(neuron, currents.repeat(1000, 1))
    rates = spikes.mean(0)
    assert torch.allclose(rates, currents / 0.5, atol=1.01e-3)
    assert torch.allclose(spikes.sum(0) * 0.5 + states[-1, :, 0], 1000 * currents), "nothing of the input is lost"


def test_reset_to_zero_loses_what_is_above_the_threshold() -> None:
    spikes, _ = run(IntegrateAndFireConfig().build(MS), constant(0.3, steps=100))
    assert intervals(spikes[:, 0]) == [2] * 49, "0.3 + 0.3 = 0.6 >= 0.5, of which nothing is kept"


@pytest.mark.parametrize(("membrane", "synapse"), [(20, 5), (5, 20), (30, 1)])
def test_the_potential_of_one_input_is_the_difference_of_two_exponentials(membrane: int, synapse: int) -> None:
    config = SynapticLIFConfig(
        threshold=1e6, resistance=1.0, membrane_time_constant=f"{membrane} ms", synaptic_time_constant=f"{synapse} ms"
    )
    for step_ms in (0.25, 1.0):
        steps = int(60 / step_ms)
        impulse = constant(0.0, steps=steps)
        impulse[0] = 1.0
        _, states = run(config.build(int(step_ms * MS)), impulse)
        t = torch.arange(1, steps + 1).double() * step_ms
        shape = (-t / membrane).exp() - (-t / synapse).exp()
        scale = states[0, 0, 0] / shape[0]
        assert torch.allclose(states[:, 0, 0], scale * shape, rtol=1e-9, atol=1e-12)


def test_the_response_to_a_constant_input_is_the_closed_form_and_settles_at_its_resistance() -> None:
    config = SynapticLIFConfig(threshold=100, resistance=4.0, synaptic_time_constant="8 ms")
    a, k = math.exp(-1 / 20), math.exp(-1 / 8)
    _, states = run(config.build(MS), constant(1.5, steps=400))
    n = torch.arange(1, 401).double()
    # the sum over all inputs of (1 - a) (1 - k) (a^m - k^m) / (a - k)
    of_a, of_k = a * (1 - k) * (1 - a**n), k * (1 - a) * (1 - k**n)
    assert torch.allclose(states[:, 0, 0], 6.0 * (of_a - of_k) / (a - k), rtol=1e-9)
    assert states[-1, 0, 0] == pytest.approx(6.0, rel=1e-6)


@pytest.mark.parametrize("step_us", [250, 1000])
def test_a_synaptic_current_converges_to_the_two_differential_equations(step_us: int) -> None:
    """``U(t) = R I (1 - (m exp(-t/m) - s exp(-t/s)) / (m - s))``, at first order in the step."""
    _, states = run(
        SynapticLIFConfig(threshold=100, resistance=1.0).build(step_us * 1000), constant(1.0, steps=30_000 // step_us)
    )
    t = torch.arange(1, len(states) + 1).double() * step_us / 1000
    exact = 1 - (20 * (-t / 20).exp() - 5 * (-t / 5).exp()) / 15
    assert (states[:, 0, 0] - exact).abs().max() < 0.02 * step_us / 1000


@pytest.mark.parametrize("adaptation", [0.02, 0.1, 0.4])
def test_an_adapted_neuron_fires_at_the_interval_of_the_fixed_point(adaptation: float) -> None:
    """From a reset to zero, ``R I (1 - exp(-T/tau)) = threshold + adaptation / (exp(T/tau_a) - 1)``."""
    config = AdaptiveLIFConfig(resistance=1.0, adaptation=adaptation, adaptation_time_constant="100 ms")
    strength = torch.linspace(3, 10, 30, dtype=torch.float64)
    low, high = torch.full_like(strength, 1e-3), torch.full_like(strength, 1e3)
    for _ in range(60):
        middle = (low + high) / 2
        fires = strength * (1 - (-middle / 20).exp()) > 0.5 + adaptation / ((middle / 100).exp() - 1)
        low, high = torch.where(fires, low, middle), torch.where(fires, middle, high)
    spikes, _ = run(config.build(MS // 10), strength.repeat(8000, 1))
    for fired, expected in zip(spikes.T, low.tolist(), strict=True):
        found = intervals(fired)
        adapted = found[-len(found) // 4 :]
        assert sum(adapted) / len(adapted) * 0.1 == pytest.approx(expected, abs=0.1)
        assert found[0] < adapted[0]


def test_adaptation_of_zero_and_no_adaptation_are_the_same() -> None:
    currents = torch.randn(200, 3, generator=torch.Generator().manual_seed(0)) * 2
    spikes, states = run(AdaptiveLIFConfig(adaptation=0.0).build(MS), currents)
    expected, potentials = run(ExactLIFConfig().build(MS), currents)
    assert torch.equal(spikes, expected)
    assert torch.equal(states[..., :1], potentials)


@resets
@pytest.mark.parametrize("class_", ["Leaky", "Synaptic"])
def test_spikes_and_states_are_snntorchs_bit_for_bit(class_: str, reset: Reset) -> None:
    """While no potential stays above the threshold after a subtraction; snnTorch would not let it fire at once."""
    options: dict[str, Any] = {"beta": 0.9, "reset_mechanism": reset, "reset_delay": False}
    options |= {"alpha": 0.7} if class_ == "Synaptic" else {}
    theirs = getattr(snntorch, class_)(threshold=1.0, **options)
    ours = GeneralizedLIF(
        threshold=just_above(1.0) if reset == "zero" else 1.0,
        decay=0.9,
        synapse_decay=0.7 if class_ == "Synaptic" else None,
        reset=reset,
    )
    state = ours.at_rest(4, 10)
    variables = [torch.zeros(4, 10) for _ in range(ours.variables)]  # syn, mem
    fired = 0.0
    for current in torch.rand(300, 4, 10, generator=torch.Generator().manual_seed(1)) * 0.39 - 0.1:
        spikes, state = ours.step(current, state)
        expected, *variables = theirs(current, *variables)
        assert torch.equal(spikes, expected)
        assert torch.equal(state, torch.cat(variables[::-1], dim=1))
        fired += float(spikes.mean())
    assert 3 < fired < 200


def test_a_synaptic_lif_from_a_file_is_snntorchs_with_the_gain_on_its_input() -> None:
    config = SynapticLIFConfig(fires="above", resistance=20.0)
    neuron = config.build(MS)
    alpha, beta = math.exp(-1 / 5), math.exp(-1 / 20)
    theirs = snntorch.Synaptic(alpha=alpha, beta=beta, threshold=0.5, reset_mechanism="zero", reset_delay=False)
    gain = 20.0 * (1 - alpha) * (1 - beta)
    state, syn, mem = neuron.at_rest(3, 20), torch.zeros(3, 20), torch.zeros(3, 20)
    ours, expected = [], []
    for current in torch.randn(300, 3, 20, generator=torch.Generator().manual_seed(2)):
        spikes, state = neuron.step(current, state)
        spike, syn, mem = theirs(current * gain, syn, mem)
        ours.append(spikes)
        expected.append(spike)
    assert torch.equal(torch.stack(ours), torch.stack(expected))
    assert 0.01 < torch.stack(ours).mean() < 0.5


class Step(torch.autograd.Function):
    """A firing step with a derivative of its own, ``0.5 / (1 + |x|)^2``."""

    @staticmethod
    def forward(ctx: Any, distance: Tensor) -> Tensor:
        ctx.save_for_backward(distance)
        return (distance >= 0).to(distance.dtype)

    @staticmethod
    def backward(ctx: Any, *grad: Tensor) -> Tensor:
        (distance,) = ctx.saved_tensors
        return grad[0] * 0.5 / (1 + distance.abs()) ** 2


NEURONS = {
    "leaky": GeneralizedLIF(0.5, 0.9, 0.8),
    "leaky, subtract": GeneralizedLIF(0.5, 0.9, 0.8, reset="subtract"),
    "leaky, detached": GeneralizedLIF(0.5, 0.9, 0.8, reset_gradient="detached"),
    "synaptic": GeneralizedLIF(0.5, 0.9, 0.4, synapse_decay=0.7),
    "adaptive": GeneralizedLIF(0.5, 0.9, 0.8, adaptation=0.3, adaptation_decay=0.95),
    "all": GeneralizedLIF(0.5, 0.9, 0.4, 0.7, 0.3, 0.95, "subtract", reset_gradient="detached"),
}
all_neurons = pytest.mark.parametrize("neuron", NEURONS.values(), ids=NEURONS)


def written_out(neuron: GeneralizedLIF, currents: Tensor) -> Tensor:
    """The equations of the class, with their own firing step."""
    potential = current = adaptation = torch.zeros_like(currents[0])
    fired = []
    for now in currents:
        current = now if neuron.synapse_decay is None else neuron.synapse_decay * current + now
        before = neuron.decay * potential + neuron.input_gain * current
        spikes = Step.apply(before - neuron.threshold - (neuron.adaptation or 0.0) * adaptation)
        carried = spikes.detach() if neuron.reset_gradient == "detached" else spikes
        potential = before * (1 - carried) if neuron.reset == "zero" else before - neuron.threshold * carried
        adaptation = neuron.adaptation_decay * adaptation + spikes
        fired.append(spikes)
    return torch.stack(fired)


@all_neurons
def test_spikes_and_gradients_are_those_of_the_equations_written_out(neuron: GeneralizedLIF) -> None:
    surrogate = Surrogate("fast_sigmoid", width=2 * (math.sqrt(2) - 1))
    stepped = dataclasses.replace(neuron, surrogate=surrogate)
    currents = torch.randn(30, 4, generator=torch.Generator().manual_seed(3)).double()
    weight = torch.randn(30, 4, generator=torch.Generator().manual_seed(4)).double()
    ours, theirs = (currents.clone().requires_grad_() for _ in range(2))
    spikes, expected = run(stepped, ours)[0], written_out(neuron, theirs)
    assert torch.equal(spikes, expected)
    assert 0.05 < spikes.mean() < 0.95
    (spikes * weight).sum().backward()
    (expected * weight).sum().backward()
    assert ours.grad is not None and theirs.grad is not None
    assert torch.allclose(ours.grad, theirs.grad, rtol=1e-9, atol=1e-12)


@all_neurons
def test_away_from_the_threshold_gradients_are_those_of_finite_differences(neuron: GeneralizedLIF) -> None:
    """There the derivative of a narrow surrogate is zero, as that of the true firing step."""
    narrow = dataclasses.replace(neuron, surrogate=Surrogate("rectangular", 1e-3))
    generator = torch.Generator().manual_seed(5)
    current = torch.randn(8, 3, generator=generator).double().requires_grad_()
    state = torch.rand(8, 3 * neuron.variables, generator=generator).double().requires_grad_()
    assert torch.autograd.gradcheck(narrow.step, (current, state))
    assert 0 < narrow.step(current, state)[0].mean() < 1
