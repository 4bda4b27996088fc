"""The exponential that both paths share: how near it is to the true one, and its gradient."""

import math

import pytest
import torch

from neurorobo.neurons.exponential import LEAST, MOST, exponential, sigmoid


def test_the_relative_error_is_that_of_single_precision_over_the_whole_range() -> None:
    x = torch.cat([torch.linspace(LEAST, MOST, 2_000_001), torch.linspace(-1, 1, 200_001)])
    exact = x.double().exp()
    assert ((exponential(x).double() - exact).abs() / exact).max() < 2e-7
    assert float(exponential(torch.zeros(1))) == 1


def test_where_the_power_of_two_changes_nothing_jumps() -> None:
    """Around odd multiples of ln(2) / 2, numbers that are next to each other have results that are."""
    edges = (torch.arange(-124, 126, dtype=torch.float64) + 0.5) * math.log(2)
    below, above = edges.float(), torch.nextafter(edges.float(), torch.tensor(math.inf))
    rise = exponential(above) / exponential(below) - 1
    assert (rise.double() - (above.double() - below.double())).abs().max() < 4e-7


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_beyond_its_range_it_stays_as_it_is_and_finite(dtype: torch.dtype) -> None:
    ends = torch.tensor([LEAST, MOST], dtype=dtype)
    assert torch.equal(exponential(torch.tensor([-1e30, 1e30], dtype=dtype)), exponential(ends))
    assert exponential(ends).isfinite().all()
    assert (exponential(ends) > torch.finfo(torch.float32).tiny).all()


@pytest.mark.parametrize("function", [exponential, sigmoid])
def test_gradients_are_those_of_finite_differences(function: object) -> None:
    x = torch.linspace(-8, 8, 41, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(function, (x,))


def test_its_derivative_is_itself() -> None:
    x = torch.linspace(-80, 80, 1001, requires_grad=True)
    power = exponential(x)
    power.sum().backward()
    assert torch.equal(x.grad, power.detach())
