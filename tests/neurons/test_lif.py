"""The neuron's equations, by hand and by analysis."""

import math
from typing import Any

import pytest
import torch
from hypothesis import assume, given
from hypothesis import strategies as st

from neurorobo.neurons import LIF, Surrogate, spiking_neural_unit


def fire(neuron: LIF, currents: list[float]) -> tuple[list[float], list[float]]:
    """Step one neuron from rest; return its spikes and its potentials."""
    spikes, potentials = [], []
    potential = torch.zeros(1, dtype=torch.float64)
    for current in currents:
        spike, potential = neuron.step(torch.tensor([current], dtype=torch.float64), potential)
        spikes.append(spike.item())
        potentials.append(potential.item())
    return spikes, potentials


def test_six_steps_by_hand_with_a_tie_at_the_threshold() -> None:
    """Eq. 5-7; halves and quarters, so that the tie at the second step is exact."""
    spikes, potentials = fire(LIF(threshold=0.5, decay=0.25), [0.5 - 0.125, 0.40625, 0.25, 0.0, 0.5, -0.25])
    # 0.375 stays | 0.25*0.375 + 0.40625 = 0.5 fires | reset, so 0.25 | 0.0625 | 0.015625 + 0.5 fires | reset, so -0.25
    assert potentials == [0.375, 0.5, 0.25, 0.0625, 0.515625, -0.25]
    assert spikes == [0, 1, 0, 0, 1, 0]


def test_the_new_input_is_added_after_the_reset() -> None:
    spikes, potentials = fire(LIF(threshold=0.5, decay=0.2), [2.0, 0.4, 0.4])
    assert potentials == pytest.approx([2.0, 0.4, 0.48])
    assert spikes == [1, 0, 0]


def test_a_spiking_neural_unit_is_rectified_so_that_inhibition_leaves_no_debt() -> None:
    currents = [-1.0, 0.5, -0.25]
    assert fire(LIF(decay=0.5), currents)[1] == [-1.0, 0.0, -0.25]
    assert fire(spiking_neural_unit(decay=0.5), currents) == ([0, 1, 0], [0.0, 0.5, 0.0])


@given(decay=st.floats(0, 0.99), threshold=st.floats(0.01, 10), share=st.floats(0, 0.999))
def test_a_constant_current_below_the_rheobase_never_fires(decay: float, threshold: float, share: float) -> None:
    """The potential rises towards ``I / (1 - decay)`` and so stays below the threshold."""
    spikes, _ = fire(LIF(threshold, decay), [share * threshold * (1 - decay)] * 200)
    assert sum(spikes) == 0


@given(decay=st.floats(0.01, 0.95), threshold=st.floats(0.01, 10), strength=st.floats(1.001, 3))
def test_a_constant_current_fires_at_the_interval_that_the_f_i_relation_tells(
    decay: float, threshold: float, strength: float
) -> None:
    """After n steps from rest ``U = I (1 - decay**n) / (1 - decay)``; each spike puts the neuron back to rest."""
    current = strength * threshold * (1 - decay)
    exact = math.log(1 - 1 / strength) / math.log(decay)
    assume(abs(exact - round(exact)) > 1e-6)  # else rounding decides whether the threshold is met
    interval = math.ceil(exact)
    spikes, _ = fire(LIF(threshold, decay), [current] * 60)
    assert [step for step, spike in enumerate(spikes, 1) if spike] == list(range(interval, 61, interval))


def test_any_shape_of_neurons_steps_together() -> None:
    current = torch.linspace(-1, 2, 24).view(2, 3, 4)
    spikes, potential = LIF().step(current, torch.zeros(2, 3, 4))
    assert torch.equal(potential, current)
    assert torch.equal(spikes, (current >= 0.5).float())


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"decay": 1.1}, "decay .* lies in 0..1, got 1.1"),
        ({"decay": -0.1}, "0..1"),
        ({"decay": math.nan}, "0..1, got nan"),
        ({"threshold": 0.0}, "positive"),
        ({"threshold": math.nan}, "positive.* got nan"),
        ({"threshold": math.inf}, "finite, got inf"),
        ({"reset_gradient": "none"}, "`full` or `detached`, not 'none'"),
    ],
)
def test_neurons_that_make_no_sense_are_refused(settings: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        LIF(**settings)


def test_a_unit_keeps_the_settings_it_is_given() -> None:
    unit = spiking_neural_unit(0.7, 0.3, Surrogate("arctan", 0.5))
    assert unit == LIF(0.7, 0.3, Surrogate("arctan", 0.5), rectify=True)
