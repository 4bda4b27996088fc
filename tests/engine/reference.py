"""The neuron model once more, as plainly as autograd allows; the engine must agree with it."""

from typing import Any

import torch
from torch import Tensor

from neurorobo.neurons import LIF, Surrogate


class Fire(torch.autograd.Function):
    """The step function, with a surrogate for its derivative."""

    @staticmethod
    def forward(ctx: Any, distance: Tensor, surrogate: Surrogate) -> Tensor:
        ctx.save_for_backward(distance)
        ctx.surrogate = surrogate
        return (distance >= 0).to(distance.dtype)

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor, None]:  # type: ignore[override]
        (distance,) = ctx.saved_tensors
        return grad * ctx.surrogate.derivative(distance), None


def run_window(
    current: Tensor, potential: Tensor, neuron: LIF, threshold: Tensor, recurrent_weight: Tensor | None = None
) -> tuple[Tensor, Tensor]:
    """Eq. 5-7, step by step."""
    fired = Fire.apply(potential - threshold, neuron.surrogate)
    spikes = []
    for now in current:
        reset = fired if neuron.reset_gradient == "full" else fired.detach()
        if recurrent_weight is not None:
            now = now + fired @ recurrent_weight.t()
        potential = now + neuron.decay * potential * (1 - reset)
        if neuron.rectify:
            potential = potential.relu()
        fired = Fire.apply(potential - threshold, neuron.surrogate)
        spikes.append(fired)
    return torch.stack(spikes), potential
