"""A layer has one interface: a window in one call, in pieces, or step by step gives the same."""

from typing import Any

import pytest
import torch
from torch import Tensor

from neurorobo.engine import Layer
from neurorobo.neurons import LIF, Surrogate
from neurorobo.regions.weights import to_grid
from neurorobo.synapses import Dense, FanIn, Projection

ARCTAN = Surrogate("arctan")


class Adaptive:
    """A neuron of two variables: each spike lowers the next potentials for a while."""

    def at_rest(self, batch: int, neurons: int) -> Tensor:
        return torch.zeros(batch, 2 * neurons)

    def step(self, current: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        potential, fatigue = state.chunk(2, dim=1)
        potential = current + 0.25 * potential - 0.25 * fatigue
        fired = ARCTAN.fire(potential - 0.5)
        return fired, torch.cat([potential * (1 - fired), 0.5 * fatigue + fired], dim=1)


SOURCES = (70, 40)
LAYERS: dict[str, tuple[Any, bool, bool]] = {  # the neuron, whether it is recurrent, and whether thresholds are trained
    "feedforward": (LIF(surrogate=ARCTAN), False, False),
    "thresholds": (LIF(surrogate=ARCTAN), False, True),
    "recurrent": (LIF(surrogate=ARCTAN), True, False),
    "rectified": (LIF(surrogate=ARCTAN, rectify=True, reset_gradient="detached"), True, True),
    "adaptive": (Adaptive(), False, False),
    "adaptive recurrent": (Adaptive(), True, False),
}


def generator(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def build(kind: str) -> Layer:
    """A layer of a dense and a sparse projection, on the grid, where sums are exact."""
    neuron, recurrent, thresholds = LAYERS[kind]
    projections: list[Projection] = [
        Dense(SOURCES[0], 83, generator(0), gain=1.2),
        FanIn(SOURCES[1], 83, 4, generator(1), gain=1.2),
    ]
    own = Dense(83, 83, generator(2), gain=0.6) if recurrent else None
    layer = Layer(projections, neuron, own, trainable_threshold=thresholds)
    with torch.no_grad():
        if layer.threshold is not None:
            layer.threshold += 0.2 * torch.rand(83, generator=generator(3))
        for parameter in layer.parameters():
            parameter.copy_(to_grid(parameter, 12))
    return layer


def problem(layer: Layer, steps: int) -> tuple[list[Tensor], Tensor]:
    inputs = [(torch.rand(steps, 3, n, generator=generator(n)) < 0.3).float() for n in SOURCES]
    return inputs, torch.rand(layer.at_rest(3).shape, generator=generator(5)).round()  # it may hold spikes


def in_pieces(layer: Layer, inputs: list[Tensor], state: Tensor, pieces: list[int]) -> tuple[Tensor, Tensor]:
    parts = []
    for piece in zip(*(x.split(pieces) for x in inputs), strict=True):
        fired, state = layer(list(piece), state)
        parts.append(fired)
    return torch.cat(parts), state


kinds = pytest.mark.parametrize("kind", LAYERS)
divisions = pytest.mark.parametrize("pieces", [[1] * 130, [64, 66], [3, 127]], ids=["streaming", "halves", "uneven"])


@kinds
@divisions
@pytest.mark.parametrize("training", [False, True], ids=["inference", "training"])
def test_a_window_in_pieces_is_the_whole_window_bit_for_bit(
    path: str, kind: str, pieces: list[int], training: bool
) -> None:
    layer = build(kind)
    inputs, state = problem(layer, 130)
    with torch.set_grad_enabled(training):
        whole, last = layer(inputs, state)
        found, found_last = in_pieces(layer, inputs, state, pieces)
    assert torch.equal(found, whole)
    assert torch.equal(found_last, last)
    assert 0.05 < whole.mean() < 0.95


@kinds
@pytest.mark.parametrize("pieces", [[1] * 70, [64, 6]], ids=["streaming", "uneven"])
def test_gradients_go_through_the_state_from_piece_to_piece(path: str, kind: str, pieces: list[int]) -> None:
    layer = build(kind)
    inputs, state = problem(layer, 70)
    leaves = [*layer.parameters(), *(x.requires_grad_() for x in inputs), state.requires_grad_()]
    of_spikes = torch.randn(70, 3, 83, generator=generator(6))
    found = []
    for fired, last in (layer(inputs, state), in_pieces(layer, inputs, state, pieces)):
        found.append(torch.autograd.grad((fired * of_spikes).sum() + last.sum(), leaves))
    for whole, cut in zip(*found, strict=True):
        assert whole.abs().max() > 0
        assert (whole - cut).abs().max() <= 1e-5 * whole.abs().max()


@pytest.mark.parametrize("kind", [kind for kind, (_, _, thresholds) in LAYERS.items() if not thresholds])
@torch.no_grad()
def test_each_step_is_that_of_the_projections_and_the_neuron_called_by_hand(path: str, kind: str) -> None:
    layer = build(kind)
    neuron, recurrent, _ = LAYERS[kind]
    inputs, state = problem(layer, 20)
    spikes, _ = layer(inputs, state)
    variables, fired = state, torch.zeros(3, 83)
    if recurrent and isinstance(neuron, LIF):
        fired = (state >= neuron.threshold).float()
    elif recurrent:
        variables, fired = state[:, :-83], state[:, -83:]
    for t in range(20):
        current = sum(p(x[t]) for p, x in zip(layer.projections, inputs, strict=True))
        if layer.recurrent is not None:
            current = current + layer.recurrent(fired)
        fired, variables = neuron.step(current, variables)
        assert torch.equal(fired, spikes[t])
