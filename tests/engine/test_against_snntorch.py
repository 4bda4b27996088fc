"""The claims of `docs/explanation/neurons_and_engine.md`: what equals snnTorch's neuron, and what its options change.

Weights lie on a grid of 2**-8 and the decay is a quarter, so that sums are exact whatever their order.
"""

import math
from collections.abc import Callable
from typing import Literal

import pytest
import snntorch
import torch
from snntorch import surrogate as theirs
from torch import Tensor

from neurorobo.engine import run_window
from neurorobo.neurons import LIF, Surrogate, just_above
from neurorobo.neurons.config import LIFConfig, SpikingNeuralUnitConfig, SurrogateConfig
from neurorobo.neurons.surrogate import SurrogateShape

STEPS, BATCH, SOURCES, NEURONS = 20, 8, 40, 15
WIDTH = 0.8
THRESHOLD = 0.51  # off the grid, so that no potential meets it


class Problem:
    """Spikes, weights on a grid, and a random loss."""

    def __init__(self) -> None:
        generator = torch.Generator().manual_seed(3)
        self.inputs = (torch.rand(STEPS, BATCH, SOURCES, generator=generator) < 0.3).float()
        self.weights = {
            "weight": (torch.randn(NEURONS, SOURCES, generator=generator) * 0.25 * 256).round() / 256,
            "recurrent": (torch.randn(NEURONS, NEURONS, generator=generator) * 0.1 * 256).round() / 256,
        }
        self.of_spikes = torch.randn(STEPS, BATCH, NEURONS, generator=generator)

    def solve(self, run: Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]) -> tuple[Tensor, Tensor, dict[str, Tensor]]:
        """Return the spikes, the last potential and the gradients of the weights."""
        leaves = {name: weight.clone().requires_grad_() for name, weight in self.weights.items()}
        spikes, potential = run(self.inputs @ leaves["weight"].t(), leaves["recurrent"])
        (spikes * self.of_spikes).sum().backward()
        return spikes.detach(), potential.detach(), {name: leaf.grad for name, leaf in leaves.items()}  # type: ignore[misc]


def ours(neuron: LIF) -> Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]:
    return lambda current, recurrent: run_window(current, torch.zeros(BATCH, NEURONS), neuron, None, recurrent)


def leaky(
    neuron: LIF, threshold: float, spike_grad: Callable[[Tensor], Tensor], *, reset_delay: bool
) -> Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]:
    """snnTorch's neuron in a loop of one's own; it fires above its threshold, and not at it."""
    model = snntorch.Leaky(
        beta=neuron.decay,
        threshold=threshold,
        reset_mechanism="zero",
        reset_delay=reset_delay,
        spike_grad=spike_grad,
    )

    def run(current: Tensor, recurrent: Tensor) -> tuple[Tensor, Tensor]:
        fired, membrane, spikes = torch.zeros(BATCH, NEURONS), torch.zeros(BATCH, NEURONS), []
        for now in current:
            fired, membrane = model(now + fired @ recurrent.t(), membrane)
            spikes.append(fired)
        return torch.stack(spikes), membrane

    return run


def as_theirs(surrogate: Surrogate) -> Callable[[Tensor], Tensor]:
    return theirs.custom_surrogate(lambda distance, grad, _: grad * surrogate.derivative(distance))  # type: ignore[no-any-return]


def assert_same_gradients(found: dict[str, Tensor], expected: dict[str, Tensor]) -> None:
    for name, gradient in found.items():
        scale = expected[name].abs().max()
        assert scale > 0
        assert (gradient - expected[name]).abs().max() <= 1e-5 * scale, name


@pytest.mark.parametrize("shape", ["rectangular", "triangular", "arctan", "fast_sigmoid"])
@pytest.mark.parametrize(("reset_gradient", "reset_delay"), [("detached", True), ("full", False)])
def test_spikes_and_gradients_are_those_of_snntorch(
    path: str, shape: SurrogateShape, reset_gradient: Literal["full", "detached"], reset_delay: bool
) -> None:
    """The delayed reset of snnTorch passes no gradient, the other one does."""
    neuron = LIF(THRESHOLD, 0.25, Surrogate(shape, WIDTH), reset_gradient)
    spikes, potential, gradients = Problem().solve(ours(neuron))
    their_spikes, their_potential, their_gradients = Problem().solve(
        leaky(neuron, THRESHOLD, as_theirs(neuron.surrogate), reset_delay=reset_delay)
    )
    assert torch.equal(spikes, their_spikes)
    assert 0.1 < spikes.mean() < 0.9
    after_reset = potential if reset_delay else potential * (1 - spikes[-1])
    assert torch.equal(after_reset, their_potential)
    assert_same_gradients(gradients, their_gradients)


@pytest.mark.parametrize(
    ("shape", "spike_grad", "scale"),
    [
        ("arctan", theirs.atan(alpha=4 / (math.pi * WIDTH)), 1.0),
        ("fast_sigmoid", theirs.fast_sigmoid(slope=2 * (math.sqrt(2) - 1) / WIDTH), (math.sqrt(2) - 1) / WIDTH),
    ],
)
def test_two_of_the_surrogates_are_snntorch_s_own(
    shape: SurrogateShape, spike_grad: Callable[[Tensor], Tensor], scale: float
) -> None:
    distance = torch.linspace(-3, 3, 601, requires_grad=True)
    spike_grad(distance).sum().backward()
    assert distance.grad is not None
    assert torch.allclose(Surrogate(shape, WIDTH).derivative(distance.detach()), scale * distance.grad, rtol=1e-5)


def test_the_triangular_surrogate_of_snntorch_is_no_triangle() -> None:
    distance = torch.tensor([-5.0, -0.1, 0.1, 5.0], requires_grad=True)
    theirs.triangular(threshold=1)(distance).sum().backward()
    assert distance.grad is not None
    assert distance.grad.tolist() == [1, 1, -1, -1]
    assert Surrogate("triangular", 1.0).derivative(distance.detach()).tolist() == pytest.approx([0, 0.9, 0.9, 0])


@pytest.mark.parametrize("reset_delay", [True, False])
def test_a_potential_at_the_threshold_fires_or_as_with_snntorch_does_not(path: str, reset_delay: bool) -> None:
    """A threshold on the grid is met often; without recurrence, so that ties can be counted."""
    problem = Problem()
    problem.weights["recurrent"].zero_()
    problem.weights["weight"] = (problem.weights["weight"] * 8).round() / 8
    strict = LIF(just_above(0.5), 0.25, Surrogate("arctan"))
    spikes, _, gradients = problem.solve(ours(strict))
    their_spikes, _, their_gradients = problem.solve(
        leaky(strict, 0.5, as_theirs(strict.surrogate), reset_delay=reset_delay)
    )
    assert torch.equal(spikes, their_spikes)
    if not reset_delay:
        assert_same_gradients(gradients, their_gradients)
    at, _, _ = problem.solve(ours(LIF(0.5, 0.25, Surrogate("arctan"))))
    current = problem.inputs @ problem.weights["weight"].t()
    ties = current[0] == 0.5
    assert ties.any()
    assert at[0][ties].all()
    assert not spikes[0][ties].any()
    assert torch.equal(at[0][~ties], spikes[0][~ties])


def test_the_recurrent_neuron_of_snntorch_drops_the_input_of_the_step_after_a_spike() -> None:
    model = snntorch.RLeaky(
        beta=0.25,
        threshold=0.5,
        reset_mechanism="zero",
        reset_delay=True,
        all_to_all=False,
        V=0.0,
        learn_recurrent=False,
    )
    fired, membrane = torch.zeros(1, 1), torch.zeros(1, 1)
    theirs_found = []
    for now in (1.0, 0.75, 0.25):
        fired, membrane = model(torch.tensor([[now]]), fired, membrane)
        theirs_found.append(membrane.item())
    potential, ours_found = torch.zeros(1), []
    for now in (1.0, 0.75, 0.25):
        _, potential = LIF(0.5, 0.25).step(torch.tensor([now]), potential)
        ours_found.append(potential.item())
    assert theirs_found == [1.0, 0.0, 0.25]
    assert ours_found == [1.0, 0.75, 0.25]


@pytest.mark.parametrize("threshold", [0.5, 0.51, 1.0, 3e-5, 7.3])
def test_no_potential_lies_between_a_threshold_and_the_one_just_above(threshold: float) -> None:
    single = torch.tensor(threshold)
    above = torch.tensor(just_above(threshold))
    assert above > single
    assert torch.equal(torch.nextafter(above, single), single)


def test_a_file_names_the_tie_rule_the_surrogate_and_the_reset_gradient() -> None:
    assert LIFConfig(fires="above", reset_gradient="detached").build(10**6) == LIF(
        just_above(0.5), reset_gradient="detached"
    )
    assert LIFConfig().build(10**6) == LIF() == LIFConfig(fires="at", reset_gradient="full").build(10**6)
    surrogate = SurrogateConfig(shape="triangular", width=0.3)
    unit = SpikingNeuralUnitConfig(fires="above", surrogate=surrogate).build(10**6)
    assert unit == LIF(just_above(0.5), surrogate=Surrogate("triangular", 0.3), rectify=True)


def test_the_rectangle_has_no_derivative_at_its_edges_nor_at_rest_by_default(path: str) -> None:
    """By default its edges are at 0 and 1, and a neuron at rest lies on one of them."""

    def derivatives(potentials: list[float], neuron: LIF) -> list[float]:
        current = torch.tensor([[potentials]], requires_grad=True)
        spikes, _ = run_window(current.clone(), torch.zeros(1, len(potentials)), neuron)
        spikes.sum().backward()
        assert current.grad is not None
        return current.grad.flatten().tolist()  # type: ignore[no-any-return]

    below_one = 1 - 2**-24
    assert derivatives([0.0, 1.0], LIF()) == [0, 0]
    assert derivatives([2**-24, below_one, 0.5], LIF()) == [1, 1, 1]
    assert derivatives([0.0, 1.0], LIF(just_above(0.5))) == [0, 1]  # the edges move with the threshold
    assert derivatives([0.0, 1.0], LIF(surrogate=Surrogate(width=1.001))) == pytest.approx([1 / 1.001] * 2)
