"""Synapses that learn from spikes that a test makes up."""

from collections.abc import Sequence

import torch
from torch import Tensor

from neurorobo.neurons import LIF
from neurorobo.plasticity import Activity, LearningRule
from neurorobo.plasticity.synapses import CHANGE, PlasticSynapses
from neurorobo.units import Interval

STEP_NS = 1_000_000
ANY = Interval(-1e6, 1e6)


def train(at: Sequence[int], steps: int) -> Tensor:
    """Spikes (steps, 1, 1) of one neuron at these steps."""
    spikes = torch.zeros(steps, 1, 1)
    spikes[list(at)] = 1
    return spikes


def change(
    rule: LearningRule,
    sources: Tensor,
    targets: Tensor,
    *,
    windows: int = 1,
    modulator: Tensor | None = None,
    source_index: Tensor | None = None,
    weight: float = 0.0,
) -> Tensor:
    """By what weights (batch, ...) change, in so many equal windows; ``modulator`` is (windows, batch, targets)."""
    synapses = PlasticSynapses([rule], ANY, source_index)
    shape = (targets.shape[2], sources.shape[2]) if source_index is None else source_index.shape
    weights = torch.full(shape, weight)
    state = synapses.init_state(sources.shape[1], weights, sources.shape[2])
    for number, (source, target) in enumerate(zip(sources.chunk(windows), targets.chunk(windows), strict=True)):
        activity = Activity(source, target, STEP_NS, LIF())
        state = synapses.learn(weights, activity, [None if modulator is None else modulator[number]], state)
    return state[CHANGE]
