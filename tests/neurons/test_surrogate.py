"""The surrogates are what they say: of area one, and as wide as they say."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from snntorch import surrogate as snntorch_surrogate

from neurorobo.neurons.surrogate import Surrogate, SurrogateShape

shapes = pytest.mark.parametrize("shape", ["rectangular", "triangular", "arctan", "fast_sigmoid"])
widths = st.floats(0.01, 100)


@shapes
@given(width=widths)
def test_the_area_is_one(shape: SurrogateShape, width: float) -> None:
    """The whole axis by ``x = width * tan(u)``, with the midpoint rule in u."""
    points = 20_000
    u = ((torch.arange(points, dtype=torch.float64) + 0.5) / points - 0.5) * math.pi
    x, dx_du = width * u.tan(), width / u.cos() ** 2
    area = (Surrogate(shape, width).derivative(x) * dx_du).sum() * math.pi / points
    assert area == pytest.approx(1.0, abs=1e-3)


@shapes
@given(width=widths)
def test_the_width_is_that_at_half_the_maximum(shape: SurrogateShape, width: float) -> None:
    at = width / 2 * torch.tensor([0.0, 0.999, 1.001, -0.999, -1.001], dtype=torch.float64)
    peak, *flanks = Surrogate(shape, width).derivative(at).tolist()
    within, beyond = flanks[::2], flanks[1::2]
    assert min(within) > peak / 2 > max(beyond)


@shapes
def test_the_derivative_is_even_and_falls_on_both_sides_without_touching_its_argument(shape: SurrogateShape) -> None:
    x = torch.linspace(-3, 3, 601)
    given_x = x.clone()
    y = Surrogate(shape, 0.8).derivative(x)
    assert torch.equal(x, given_x)
    assert torch.allclose(y, y.flip(0))
    assert (y[300:].diff() <= 0).all()
    assert (y >= 0).all()


def snntorch_derivative(name: str, slope: float, x: torch.Tensor) -> torch.Tensor:
    x = x.clone().requires_grad_()
    getattr(snntorch_surrogate, name)(slope)(x).sum().backward()
    assert x.grad is not None
    return x.grad


def test_the_shapes_are_those_of_snntorch() -> None:
    x = torch.linspace(-3, 3, 601)
    width = 0.7
    arctan = snntorch_derivative("atan", 4 / (math.pi * width), x)
    assert torch.allclose(Surrogate("arctan", width).derivative(x), arctan, rtol=1e-5)
    slope = 2 * (math.sqrt(2) - 1) / width
    fast_sigmoid = snntorch_derivative("fast_sigmoid", slope, x) * slope / 2  # of area one, which theirs is not
    assert torch.allclose(Surrogate("fast_sigmoid", width).derivative(x), fast_sigmoid, rtol=1e-5)


def test_an_unknown_shape_is_refused_with_those_there_are() -> None:
    with pytest.raises(ValueError, match="no surrogate 'gaussian'; there are: rectangular, triangular, arctan"):
        Surrogate("gaussian")  # type: ignore[arg-type]


@pytest.mark.parametrize("width", [0.0, -1.0, math.nan, math.inf])
def test_a_surrogate_without_width_is_refused(width: float) -> None:
    with pytest.raises(ValueError, match=f"positive width that is finite, got {width}"):
        Surrogate("arctan", width)


@shapes
def test_firing_is_a_step_forwards_and_the_surrogate_backwards(shape: SurrogateShape) -> None:
    surrogate = Surrogate(shape, 0.7)
    distance = torch.tensor([-3.0, -0.2, 0.0, 0.1, 3.0], requires_grad=True)
    fired = surrogate.fire(distance)
    assert fired.tolist() == [0, 0, 1, 1, 1]
    fired.sum().backward()
    assert torch.equal(distance.grad, surrogate.derivative(distance.detach()))  # type: ignore[arg-type]
