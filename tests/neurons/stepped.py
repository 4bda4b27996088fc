"""Neurons stepped one by one, in double precision."""

import torch
from torch import Tensor

from neurorobo.neurons import Neuron


def run(neuron: Neuron, currents: Tensor, state: Tensor | None = None) -> tuple[Tensor, Tensor]:
    """Step single neurons (steps, batch), from rest or not; return what they send, and states (steps, batch, ...)."""
    state = neuron.at_rest(currents.shape[1], 1).double() if state is None else state
    sent, states = [], []
    for current in currents.double().unsqueeze(2):
        now, state = neuron.step(current, state)
        sent.append(now[:, 0])
        states.append(state)
    return torch.stack(sent), torch.stack(states)


def constant(*currents: float, steps: int) -> Tensor:
    """Return currents (steps, batch) that stay as they are."""
    return torch.tensor(currents, dtype=torch.float64).repeat(steps, 1)


def intervals(spikes: Tensor) -> list[int]:
    """Return the steps between the spikes (steps,) of a neuron."""
    return [int(each) for each in spikes.nonzero()[:, 0].diff()]
