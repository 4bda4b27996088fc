"""e-prop against backpropagation through time."""

import torch
from torch import Tensor

from neurorobo.neurons import LIF, Surrogate
from neurorobo.plasticity import Activity
from neurorobo.plasticity.eprop import EProp
from tests.plasticity.learning import STEP_NS

RULE = EProp(modulator="error", learning_rate=1.0)


def run(weight: Tensor, recurrent: Tensor, inputs: Tensor, neuron: LIF) -> tuple[Tensor, Tensor]:
    """Return spikes and potentials (steps, batch, neurons) of a recurrent layer, by autograd."""
    potential = torch.zeros(inputs.shape[1], len(weight))
    fired, spikes, potentials = torch.zeros_like(potential), [], []
    for now in inputs:
        fired, potential = neuron.step(now @ weight.T + fired @ recurrent.T, potential)
        spikes.append(fired)
        potentials.append(potential)
    return torch.stack(spikes), torch.stack(potentials)


def gradient(sources: Tensor, spikes: Tensor, potentials: Tensor, neuron: LIF, signal: Tensor) -> Tensor:
    """What e-prop says that the gradient is, with a learning signal (steps, batch, targets)."""
    activity = Activity(sources, spikes.detach(), STEP_NS, neuron, potentials.detach() - neuron.threshold)
    [term], _ = RULE.terms(activity, {"source": torch.zeros(sources.shape[1:])})
    return torch.einsum("tbn,tbs->ns", term.target * signal, term.source)


def test_without_recurrence_and_reset_it_is_the_gradient() -> None:
    """With thresholds that are never reached, nothing is left out: e-prop is what backpropagation finds."""
    generator = torch.Generator().manual_seed(1)
    neuron = LIF(threshold=50.0, decay=0.8, surrogate=Surrogate("arctan", 40.0), reset_gradient="detached")
    weight = torch.randn(6, 10, generator=generator, requires_grad=True)
    inputs = (torch.rand(30, 4, 10, generator=generator) < 0.3).float()
    signal = torch.randn(30, 4, 6, generator=generator)
    spikes, potentials = run(weight, torch.zeros(6, 6), inputs, neuron)
    assert not spikes.any()
    (spikes * signal).sum().backward()
    found = gradient(inputs, spikes, potentials, neuron, signal)
    assert weight.grad is not None
    torch.testing.assert_close(found, weight.grad, rtol=1e-4, atol=1e-5)


def test_in_a_small_recurrent_network_it_points_where_the_gradient_does() -> None:
    """20 recurrent neurons learn a pattern by their own learning signals; the correlation is that of all weights."""
    correlations = []
    for seed in range(10):
        generator = torch.Generator().manual_seed(seed)
        neuron = LIF(threshold=0.5, decay=0.8, surrogate=Surrogate("triangular", 0.5))
        weight = (torch.randn(20, 15, generator=generator) / 15**0.5).requires_grad_()
        recurrent = (torch.randn(20, 20, generator=generator) * 0.3 / 20**0.5).requires_grad_()
        readout = torch.randn(2, 20, generator=generator)
        inputs = (torch.rand(40, 8, 15, generator=generator) < 0.2).float()
        wanted = torch.randn(40, 8, 2, generator=generator).cumsum(0)
        spikes, potentials = run(weight, recurrent, inputs, neuron)
        error = spikes @ readout.T - wanted
        (0.5 * error.square().sum()).backward()
        signal = error.detach() @ readout  # symmetric e-prop
        before = torch.cat([torch.zeros(1, 8, 20), spikes.detach()[:-1]])
        found = [gradient(heard, spikes, potentials, neuron, signal).flatten() for heard in (inputs, before)]
        assert weight.grad is not None and recurrent.grad is not None
        exact = torch.cat([weight.grad.flatten(), recurrent.grad.flatten()])
        correlations.append(float(torch.corrcoef(torch.stack([torch.cat(found), exact]))[0, 1]))
    assert min(correlations) > 0.7  # 0.77 to 0.95, 0.86 on average
