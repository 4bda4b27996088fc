"""Homeostasis: whatever a neuron hears, it comes to fire at the rate that is wanted."""

import pytest
import torch

from neurorobo.engine import run_window
from neurorobo.neurons import LIF
from neurorobo.plasticity import Activity
from neurorobo.plasticity.homeostasis import SynapticScaling
from neurorobo.plasticity.synapses import CHANGE, PlasticSynapses
from neurorobo.units import Interval
from tests.plasticity.learning import STEP_NS


@pytest.mark.parametrize("rate_Hz", [10.0, 40.0])
def test_neurons_come_to_fire_at_the_rate(rate_Hz: float) -> None:
    """Neurons that begin silent, and others that fire at hundreds of Hz; the rate is that of the last 20 s of 60 s."""
    generator = torch.Generator().manual_seed(1)
    neuron = LIF(threshold=1.0, decay=0.95)
    rule = SynapticScaling(rate=f"{rate_Hz} Hz", learning_rate=0.05, tau="1 s")
    synapses = PlasticSynapses([rule], Interval(0.0, 5.0), None)
    weight = torch.tensor([[0.03], [0.1], [0.6]]).repeat(1, 50)
    state, potential, counts = synapses.init_state(1, weight, 50), torch.zeros(1, 3), []
    for _ in range(600):
        sources = (torch.rand(100, 1, 50, generator=generator) < 0.02).float()
        current = torch.einsum("tbs,bns->tbn", sources, weight + state[CHANGE])
        spikes, potential = run_window(current, potential, neuron)
        state = synapses.learn(weight, Activity(sources, spikes, STEP_NS, neuron), [None], state)
        counts.append(spikes.sum((0, 1)))
    before, after = torch.stack(counts[:5]).mean(0) * 10, torch.stack(counts[400:]).mean(0) * 10
    assert before[0] < rate_Hz / 2 and before[2] > 2 * rate_Hz
    torch.testing.assert_close(after, torch.full((3,), rate_Hz), rtol=0.05, atol=0)
