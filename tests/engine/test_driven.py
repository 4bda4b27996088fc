"""A layer that is driven by more than its projections."""

import pytest
import torch

from neurorobo.engine import Layer
from neurorobo.neurons import LIF
from neurorobo.regions.driven import run_driven
from neurorobo.regions.weights import to_grid
from neurorobo.synapses import Dense, FanIn
from tests.engine.paths import engine, needs_native


def layer(*kinds: type, trained: bool = False) -> Layer:
    generator = torch.Generator().manual_seed(1)
    projections = [Dense(30, 20, generator) if kind is Dense else FanIn(30, 20, 4, generator) for kind in kinds]
    made = Layer(projections, LIF(), trainable_threshold=trained)
    with torch.no_grad():
        for parameter in made.parameters():
            parameter.copy_(to_grid(parameter))
    return made


def spikes(seed: int) -> torch.Tensor:
    return (torch.rand(12, 3, 30, generator=torch.Generator().manual_seed(seed)) < 0.3).float()


@pytest.mark.usefixtures("path")
@pytest.mark.parametrize("kinds", [(Dense,), (Dense, Dense), (Dense, FanIn)])
@pytest.mark.parametrize("trained", [False, True])
def test_a_current_of_nothing_changes_nothing(kinds: tuple[type, ...], trained: bool) -> None:
    made, inputs = layer(*kinds, trained=trained), [spikes(number) for number in range(len(kinds))]
    assert torch.equal(run_driven(made, inputs, torch.zeros(12, 3, 20)), made(inputs)[0])


@pytest.mark.usefixtures("path")
def test_a_current_counts_as_that_of_one_more_projection() -> None:
    both, one = layer(Dense, Dense), layer(Dense)
    inputs = [spikes(0), spikes(1)]
    current = both.projections[1](inputs[1]).detach()
    wanted = both(inputs)[0]
    assert torch.equal(run_driven(one, inputs[:1], current), wanted)
    assert not torch.equal(one(inputs[:1])[0], wanted)


@needs_native()
def test_both_paths_give_the_same_spikes() -> None:
    current = to_grid(torch.randn(12, 3, 20, generator=torch.Generator().manual_seed(2)))
    found = []
    for path in ("portable", "native"):
        with engine(path):
            found.append(run_driven(layer(Dense), [spikes(0)], current.clone()))
    assert found[0].any() and torch.equal(*found)


@pytest.mark.usefixtures("path")
def test_what_is_no_spike_is_refused() -> None:
    with pytest.raises(ValueError, match=r"0\.5"):
        run_driven(layer(Dense), [0.5 * spikes(0)], torch.zeros(12, 3, 20))


def test_a_layer_with_synapses_among_its_neurons_is_refused() -> None:
    generator = torch.Generator()
    recurrent = Layer([Dense(30, 20, generator)], LIF(), recurrent=Dense(20, 20, generator))
    with pytest.raises(ValueError, match="without synapses among themselves"):
        run_driven(recurrent, [spikes(0)], torch.zeros(12, 3, 20))
