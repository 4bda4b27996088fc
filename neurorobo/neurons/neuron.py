"""What a layer needs of its neurons."""

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from torch import Tensor


class Neuron(Protocol):
    """A neuron model: a pure step of a whole population.

    Its state is one tensor (batch, variables), with as many variables per neuron as the model has. To be trained, the
    step must be differentiable; :meth:`neurorobo.neurons.Surrogate.fire` is a firing step that is.
    """

    def at_rest(self, batch: int, neurons: int) -> "Tensor":
        """Return the state (batch, variables) of ``neurons`` neurons at rest, all zeros or not."""

    def step(self, current: "Tensor", state: "Tensor") -> "tuple[Tensor, Tensor]":
        """Advance one step: input (batch, neurons) and state -> spikes 0/1 (batch, neurons) and the next state.

        Neither argument is changed.
        """
