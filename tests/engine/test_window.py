"""The engine's scan against a plain reference, and against itself in parts."""

from typing import Literal

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from neurorobo.engine import run_window
from neurorobo.neurons import LIF, Surrogate
from neurorobo.neurons.surrogate import SurrogateShape
from tests.engine import reference

STEPS, BATCH, NEURONS = 12, 4, 7


class Problem:
    """Random currents, potentials, thresholds and weights, and the gradients of a random loss in all of them."""

    def __init__(self, dtype: torch.dtype = torch.float64, steps: int = STEPS) -> None:
        generator = torch.Generator().manual_seed(5)

        def random(*shape: int) -> Tensor:
            return torch.randn(shape, generator=generator, dtype=torch.float64).to(dtype)

        self.leaves = {
            "current": random(steps, BATCH, NEURONS) * 0.6,
            "potential": random(BATCH, NEURONS),  # some of the neurons fired just before the window
            "threshold": 0.4 + 0.2 * random(NEURONS).abs(),
            "recurrent_weight": random(NEURONS, NEURONS) * 0.4,
        }
        self.of_spikes, self.of_potential = random(steps, BATCH, NEURONS), random(BATCH, NEURONS)

    def loss(self, spikes: Tensor, potential: Tensor) -> Tensor:
        return (spikes * self.of_spikes).sum() + (potential * self.of_potential).sum()

    def solve(self, run, neuron: LIF, *, recurrent: bool) -> tuple[Tensor, dict[str, Tensor]]:  # type: ignore[no-untyped-def]
        leaves = {name: leaf.clone().requires_grad_() for name, leaf in self.leaves.items()}
        weight = leaves["recurrent_weight"] if recurrent else None
        spikes, potential = run(leaves["current"].clone(), leaves["potential"], neuron, leaves["threshold"], weight)
        self.loss(spikes, potential).backward()
        gradients = {name: leaf.grad for name, leaf in leaves.items() if leaf.grad is not None}
        return torch.cat([spikes, potential.unsqueeze(0)]).detach(), gradients


@pytest.mark.parametrize("recurrent", [False, True], ids=["feedforward", "recurrent"])
@pytest.mark.parametrize("rectify", [False, True], ids=["", "rectified"])
@pytest.mark.parametrize("reset_gradient", ["full", "detached"])
@pytest.mark.parametrize("shape", ["rectangular", "triangular", "arctan", "fast_sigmoid"])
@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float32, 1e-5), (torch.float64, 1e-9)])
def test_spikes_and_gradients_are_those_of_the_reference(
    dtype: torch.dtype,
    tolerance: float,
    shape: SurrogateShape,
    reset_gradient: Literal["full", "detached"],
    rectify: bool,
    recurrent: bool,
) -> None:
    neuron = LIF(decay=0.3, surrogate=Surrogate(shape, 0.9), reset_gradient=reset_gradient, rectify=rectify)
    problem = Problem(dtype)
    expected, expected_gradients = problem.solve(reference.run_window, neuron, recurrent=recurrent)
    found, gradients = problem.solve(run_window, neuron, recurrent=recurrent)
    assert torch.equal(found[:-1], expected[:-1])
    assert 0.1 < found[:-1].mean() < 0.9  # or nothing was compared
    assert (
        gradients.keys()
        == expected_gradients.keys()
        == problem.leaves.keys() - (set() if recurrent else {"recurrent_weight"})
    )
    for name, gradient in gradients.items():
        scale = expected_gradients[name].abs().max()
        assert scale > 0, name
        assert (gradient - expected_gradients[name]).abs().max() <= tolerance * scale, name


def test_the_reset_and_the_threshold_change_the_gradient_as_they_should() -> None:
    """The cases above would agree trivially if these settings did nothing."""
    full, detached = (
        Problem().solve(run_window, LIF(decay=0.3, reset_gradient=kind), recurrent=True)[1]["current"]
        for kind in ("full", "detached")
    )
    assert not torch.allclose(full, detached)


@given(
    eighths=st.lists(st.lists(st.integers(-8, 8), min_size=3, max_size=3), min_size=1, max_size=8),
    start=st.lists(st.integers(-8, 8), min_size=3, max_size=3),
    weights=st.lists(st.integers(-4, 4), min_size=9, max_size=9),
)
def test_spikes_are_those_of_the_reference_also_at_exact_ties(
    eighths: list[list[int]], start: list[int], weights: list[int]
) -> None:
    """On eighths and with a decay of a half every sum is exact, and potentials often equal the threshold."""
    neuron = LIF(threshold=0.5, decay=0.5)
    current = torch.tensor(eighths).unsqueeze(1) / 8
    potential, weight = torch.tensor([start]) / 8, torch.tensor(weights).view(3, 3) / 8
    expected = reference.run_window(current, potential, neuron, torch.tensor(0.5), weight)
    found = run_window(current.clone(), potential, neuron, None, weight)
    assert torch.equal(found[0], expected[0])
    assert torch.equal(found[1], expected[1])


def test_one_step_of_the_engine_is_one_step_of_the_neuron() -> None:
    leaves = Problem().leaves
    for neuron in (LIF(), LIF(rectify=True)):
        spikes, potential = neuron.step(leaves["current"][0], leaves["potential"])
        found = run_window(leaves["current"][:1].clone(), leaves["potential"], neuron)
        assert torch.equal(found[0][0], spikes)
        assert torch.allclose(found[1], potential, rtol=1e-12)  # the engine multiplies and adds in one rounding


@pytest.mark.parametrize("recurrent", [False, True])
@pytest.mark.parametrize("pieces", [[5, 7], [1] * STEPS])
def test_a_window_in_pieces_is_the_whole_window(recurrent: bool, pieces: list[int]) -> None:
    """Forwards, and backwards through the carried potential; pieces of one step are streaming."""

    def in_pieces(current, potential, neuron, threshold, weight):  # type: ignore[no-untyped-def]
        parts = []
        for piece in current.split(pieces):
            spikes, potential = run_window(piece.clone(), potential, neuron, threshold, weight)
            parts.append(spikes)
        return torch.cat(parts), potential

    neuron = LIF(decay=0.3, surrogate=Surrogate("arctan"))
    whole, whole_gradients = Problem().solve(run_window, neuron, recurrent=recurrent)
    cut, cut_gradients = Problem().solve(in_pieces, neuron, recurrent=recurrent)
    assert torch.allclose(cut, whole, rtol=1e-12)
    assert torch.equal(cut[:-1], whole[:-1])
    for name, gradient in whole_gradients.items():
        assert torch.allclose(cut_gradients[name], gradient, rtol=1e-9), name


def test_only_the_current_is_overwritten() -> None:
    leaves = {name: leaf.clone() for name, leaf in Problem().leaves.items()}
    run_window(leaves["current"], leaves["potential"], LIF(), leaves["threshold"], leaves["recurrent_weight"])
    for name, before in Problem().leaves.items():
        assert torch.equal(leaves[name], before) == (name != "current"), name


def test_a_threshold_shared_by_all_neurons_can_be_trained() -> None:
    gradients = []
    for run in (run_window, reference.run_window):
        threshold = torch.tensor(0.5, dtype=torch.float64, requires_grad=True)
        problem = Problem()
        spikes, potential = run(problem.leaves["current"].clone(), problem.leaves["potential"], LIF(), threshold)
        problem.loss(spikes, potential).backward()
        gradients.append(threshold.grad)
    assert torch.allclose(gradients[0], gradients[1], rtol=1e-9)


@pytest.mark.parametrize("memory", ["every other", "one number"])
def test_thresholds_may_lie_anywhere_in_memory(path: str, memory: str) -> None:
    wide = (
        torch.tensor([0.5, 0.9]).repeat(NEURONS)[::2] if memory == "every other" else torch.tensor(0.5).expand(NEURONS)
    )
    found = []
    for threshold in (wide, wide.contiguous()):
        problem = Problem(torch.float32)
        problem.leaves["threshold"] = threshold
        leaf = problem.leaves["potential"].clone().requires_grad_()
        spikes, potential = run_window(problem.leaves["current"].clone(), leaf, LIF(), threshold)
        problem.loss(spikes, potential).backward()
        found.append((spikes.detach(), leaf.grad))
    assert torch.equal(found[0][0], found[1][0])
    assert torch.equal(found[0][1], found[1][1])  # type: ignore[arg-type]
