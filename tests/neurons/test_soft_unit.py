"""The soft spiking neural unit beside the equations of Wozniak et al. 2020, written down anew."""

import torch
from torch import Tensor
from torch.nn import functional

from neurorobo.neurons.config import SoftSpikingNeuralUnitConfig
from neurorobo.neurons.soft_unit import SoftUnit
from tests.neurons.stepped import run


def published(inputs: Tensor, decay: float, bias: float) -> Tensor:
    """``s[t] = g(W x[t] + l s[t-1] (1 - y[t-1]))``, ``y[t] = h(s[t] + b)``, with g = ReLU and h = sigmoid."""
    s = y = torch.zeros_like(inputs[0])
    sent = []
    for x in inputs:
        s = functional.relu(x + decay * s * (1 - y))
        y = torch.sigmoid(s + bias)
        sent.append(y)
    return torch.stack(sent)


def test_it_is_the_published_unit_whose_bias_is_the_negative_threshold() -> None:
    inputs = torch.randn(60, 5, generator=torch.Generator().manual_seed(0)).double()
    unit = SoftSpikingNeuralUnitConfig(threshold=0.7, decay=0.8).build(10**6)
    assert torch.allclose(run(unit, inputs)[0], published(inputs, 0.8, -0.7), atol=1e-14)


def test_gradients_through_time_are_those_of_finite_differences() -> None:
    inputs = torch.randn(6, 3, generator=torch.Generator().manual_seed(1)).double().requires_grad_()
    assert torch.autograd.gradcheck(lambda x: run(SoftUnit(0.3, 0.7, 2.5), x)[0], (inputs,))


def test_the_steeper_the_sigmoid_the_nearer_it_comes_to_the_spiking_unit() -> None:
    inputs = torch.randn(60, 5, generator=torch.Generator().manual_seed(2)).double()
    s = y = torch.zeros(5, dtype=torch.float64)
    hard = []
    for x in inputs:
        s = functional.relu(x + 0.5 * s * (1 - y))
        y = (s >= 0.5).double()
        hard.append(y)
    errors = [
        float((run(SoftUnit(0.5, 0.5, slope), inputs)[0] - torch.stack(hard)).abs().mean()) for slope in (1, 10, 1000)
    ]
    assert errors[0] > 2 * errors[1] > 20 * errors[2]
