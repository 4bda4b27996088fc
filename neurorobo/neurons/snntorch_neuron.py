"""The neurons of snnTorch, with their state passed in and out."""

import copy
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from torch import Tensor

STATES = {"Leaky": ("mem",), "Lapicque": ("mem",), "Synaptic": ("syn", "mem"), "Alpha": ("syn_exc", "syn_inh", "mem")}
"""What each of the neurons remembers, in the order in which it takes and returns it."""

_WHOLE_WINDOW = "it takes a whole window at once and knows no reset, and neurons here are stepped; take Leaky"
_HAS_WEIGHTS = "it has weights of its own, and here the layer has them; take Synaptic"
REFUSED = {
    "RLeaky": "its recurrent weights are the layer's here; take Leaky in a layer that is recurrent",
    "RSynaptic": "its recurrent weights are the layer's here; take Synaptic in a layer that is recurrent",
    "SLSTM": _HAS_WEIGHTS,
    "SConv2dLSTM": _HAS_WEIGHTS,
    "StateLeaky": _WHOLE_WINDOW,
    "LinearLeaky": _WHOLE_WINDOW,
    "LeakyParallel": _WHOLE_WINDOW,
    "AssociativeLeaky": _WHOLE_WINDOW,
    "DeltaLeaky": "it passes on changes of its input and has no reset; write a neuron that does",
}
"""The others, each with the reason why it is refused and what there is instead."""


class SnnTorchNeuron:
    """A neuron of snnTorch as one of a layer's: ``SnnTorchNeuron(snntorch.Leaky(beta=0.9))``.

    Its state is what snnTorch's neuron remembers, such as ``syn`` and ``mem``, side by side (batch, variables x
    neurons). The spikes are those of snnTorch's own loop, the gradients are those of its surrogate. It works on a copy
    that snnTorch does not know of, in which nothing remains after a step: ``snntorch.utils.reset`` changes nothing
    here, nor does a step here change the neuron that was given. A neuron steps in one thread at a time.
    """

    def __init__(self, neuron: Any) -> None:
        """Copy a neuron.

        Raises a ValueError for neurons other than `Leaky`, `Lapicque`, `Synaptic` and `Alpha`, for one with parameters
        to be trained, which a layer would not find, with a hidden state, or whose spikes are not 0 and 1.
        """
        kind = type(neuron).__name__
        if kind not in STATES:
            raise ValueError(f"snnTorch's {kind} cannot be a neuron of a layer: {REFUSED.get(kind, 'it is not known')}")
        if trained := [name for name, _ in neuron.named_parameters()]:
            raise ValueError(
                f"`{trained[0]}` of snnTorch's {kind} would not be trained here, as a layer trains weights, and "
                "thresholds of LIF neurons; leave out `learn_...`, or take LIF"
            )
        if neuron.init_hidden or neuron.output:
            raise ValueError("a state is passed in and out here; leave out `init_hidden` and `output`")
        if (neuron.graded_spikes_factor != 1).any():
            raise ValueError("spikes are 0 or 1 here; leave out `graded_spikes_factor`, and scale the weights instead")
        self._names = STATES[kind]
        self._nothing = {name: neuron.mem.new_empty(0) for name in self._names}
        self._neuron = copy.deepcopy(neuron, {id(getattr(neuron, name)): self._nothing[name] for name in self._names})

    def at_rest(self, batch: int, neurons: int) -> "Tensor":
        """Return the state (batch, variables x neurons) of neurons at rest."""
        import torch

        return torch.zeros(batch, len(self._names) * neurons)

    def step(self, current: "Tensor", state: "Tensor") -> "tuple[Tensor, Tensor]":
        """Advance one step: input (batch, neurons) and state -> spikes and the next state."""
        import torch

        spikes, *after = self._neuron(current, *state.chunk(len(self._names), dim=1))
        for name, nothing in self._nothing.items():
            setattr(self._neuron, name, nothing)
        return spikes, torch.cat(after, dim=1)
