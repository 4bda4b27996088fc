"""A neuron of snnTorch can be wrapped as one of ours; `docs/how_to/write_a_neuron_or_code.md` shows how."""

import snntorch
import torch
from torch import Tensor

from neurorobo.engine import Layer
from neurorobo.neurons import LIF
from neurorobo.synapses import Dense


# wrapped
class Wrapped:
    """snnTorch's leaky neuron, its membrane passed in and out."""

    def __init__(self, decay: float, threshold: float) -> None:
        self.leaky = snntorch.Leaky(beta=decay, threshold=threshold, reset_mechanism="zero")

    def at_rest(self, batch: int, neurons: int) -> Tensor:
        return torch.zeros(batch, neurons)

    def step(self, current: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        return self.leaky(current, state)


# end of wrapped


def test_a_wrapped_neuron_runs_in_a_layer_and_keeps_nothing_to_itself() -> None:
    generator = torch.Generator().manual_seed(1)
    spikes = (torch.rand(50, 4, 20, generator=generator) < 0.3).float()
    synapses = Dense(20, 10, generator)
    ours, theirs = Layer([synapses], LIF(0.5, 0.2)), Layer([synapses], Wrapped(0.2, 0.5))
    with torch.no_grad():
        expected, _ = ours([spikes], ours.at_rest(4))
        first, _ = theirs([spikes], theirs.at_rest(4))
        again, _ = theirs([spikes], theirs.at_rest(4))
    assert expected.any() and torch.equal(first, expected) and torch.equal(again, expected)
