"""One whole window of a spiking layer: the scan over time, forwards and backwards.

The input currents of all steps come from one matrix product (see :mod:`neurorobo.engine.layer`); what is left is this
scan. It is one hand-written autograd function in place of a graph of several operations per step: it keeps only the
potentials and recomputes spikes and surrogates on the way back.
"""

from typing import Any

import torch
from torch import Tensor

from neurorobo.engine.checked import CheckedWeights, is_finite
from neurorobo.engine.events import Population, is_native, run_events, way_back
from neurorobo.engine.kernels import kernels
from neurorobo.neurons import LIF, Neuron
from neurorobo.synapses.product import linear


def run_window(
    current: Tensor,
    potential: Tensor,
    neuron: LIF,
    threshold: Tensor | None = None,
    recurrent_weight: Tensor | None = None,
) -> tuple[Tensor, Tensor]:
    """Run a layer of neurons through a window.

    ``current`` (steps, batch, neurons) is overwritten. ``potential`` (batch, neurons) is the potential at the end of
    the window before; it also tells which neurons fired last, since a potential is stored before its reset.
    ``threshold`` (neurons), if given, replaces the neuron's own and may be trained. ``recurrent_weight`` (neurons,
    neurons), row = target, carries each step's spikes to the next step. Returns spikes (steps, batch, neurons) and
    the last potential, differentiable in all four tensors. Raises a ValueError if a size, a type of number or a value
    that is not finite makes no sense.
    """
    _check_window(current)
    _check("current", current, current)
    check_potential(potential, current)
    neurons = current.shape[2]
    if threshold is not None:
        if threshold.shape not in ((), (neurons,)):
            raise ValueError(f"a threshold is one for all or for each of {neurons}, got {tuple(threshold.shape)}")
        _check("threshold", threshold, current)
    if recurrent_weight is not None:
        if recurrent_weight.shape != (neurons, neurons):
            raise ValueError(
                f"the recurrent weights of {neurons} neurons are of {(neurons, neurons)}, "
                f"got {tuple(recurrent_weight.shape)}"
            )
        _check("recurrent weight", recurrent_weight, current)
    return run_checked(current, potential, neuron, threshold, recurrent_weight)


def check_potential(potential: Tensor, current: Tensor, first: int = 0) -> None:
    """Raise a ValueError unless a potential (batch, neurons) fits the currents of a window, and is finite.

    The batch is counted from ``first`` on.
    """
    if current.shape[1:] != potential.shape:
        raise ValueError(
            f"the potential is of {tuple(potential.shape)} (batch, neurons), the current of {tuple(current.shape[1:])}"
        )
    _check("potential", potential, current, first)


def _check_window(current: Tensor) -> None:
    if current.dim() != 3 or len(current) == 0:
        raise ValueError(
            f"a window is of (steps, batch, neurons) and at least one step, got a current of {tuple(current.shape)}"
        )
    if not current.is_floating_point():
        raise ValueError(f"a current is of floating-point numbers, got {current.dtype}")


def _check(name: str, tensor: Tensor, current: Tensor, first: int = 0) -> None:
    """Raise a ValueError unless all numbers are finite, and of the current's type."""
    if tensor.dtype != current.dtype:
        raise ValueError(f"a {name} of {tensor.dtype} does not go with a current of {current.dtype}")
    if not is_finite(tensor):
        finite = tensor.isfinite()
        place = (~finite).nonzero()[0].tolist()
        value = tensor[tuple(place)].item()
        if place:
            place[0] += first
        raise ValueError(f"a {name} is a finite number, got {value} at {place}")


def run_checked(
    current: Tensor, potential: Tensor, neuron: LIF, threshold: Tensor | None, recurrent_weight: Tensor | None
) -> tuple[Tensor, Tensor]:
    """Do what :func:`run_window` does, with arguments that have been looked at."""
    if threshold is None:
        threshold = current.new_tensor(neuron.threshold)
    native = kernels()
    if native is not None and is_native(current, potential, threshold, recurrent_weight) and current.is_contiguous():
        population = Population(neuron, (), CheckedWeights())
        return run_events(native, population, (), (), potential, threshold, recurrent_weight, current)
    spikes, potentials = _Window.apply(current, potential, threshold, recurrent_weight, neuron)  # type: ignore[no-untyped-call]
    return spikes, potentials[-1]


def run_steps(
    current: Tensor, state: Tensor, neuron: Neuron, recurrent_weight: Tensor | None = None
) -> tuple[Tensor, Tensor]:
    """Run a layer of neurons of any model through a window, step by step; slower than :func:`run_window`.

    As there, but gradients are autograd's, nothing is overwritten, and ``state`` (batch, variables) is the neuron's.
    With a ``recurrent_weight`` it has the last spikes (batch, neurons) behind the neuron's variables. Raises a
    ValueError if the batches differ, or if the neuron returns spikes or a state of another size.
    """
    _check_window(current)
    _, batch, neurons = current.shape
    if len(state) != batch:
        raise ValueError(f"the state is of a batch of {len(state)}, the current of {batch}")
    fired: Tensor | None = None
    if recurrent_weight is not None:
        state, fired = state[:, :-neurons], state[:, -neurons:]
    before, spikes = state.shape, []
    for now in current.unbind():
        if recurrent_weight is not None and fired is not None:
            now = now + linear(fired, recurrent_weight)
        fired, state = neuron.step(now, state)
        if fired.shape != now.shape or state.shape != before:
            raise ValueError(
                f"{type(neuron).__name__}.step must return spikes of {tuple(now.shape)} and a state of "
                f"{tuple(before)}, not {tuple(fired.shape)} and {tuple(state.shape)}"
            )
        spikes.append(fired)
    if recurrent_weight is not None:
        state = torch.cat([state, spikes[-1]], dim=1)
    return torch.stack(spikes), state


class _Window(torch.autograd.Function):
    """The scan of :func:`run_window`."""

    @staticmethod
    def forward(
        ctx: Any,
        current: Tensor,
        potential: Tensor,
        threshold: Tensor,
        recurrent_weight: Tensor | None,
        neuron: LIF,
    ) -> tuple[Tensor, Tensor]:
        ctx.set_materialize_grads(False)
        ctx.mark_dirty(current)
        ctx.neuron = neuron
        # Comparisons write 0 and 1 as floats: several times faster than masks and `where`.
        spikes, kept = torch.empty_like(current), torch.empty_like(potential)
        fired = torch.ge(potential, threshold, out=torch.empty_like(potential))
        before = potential
        for now, spiking in zip(current, spikes, strict=True):
            if recurrent_weight is not None:
                now.add_(linear(fired, recurrent_weight))
            torch.lt(before, threshold, out=kept)
            now.add_(kept.mul_(before).mul_(neuron.decay))  # rounded twice, on every processor alike
            if neuron.rectify:
                now.relu_()
            fired = torch.ge(now, threshold, out=spiking)
            before = now
        ctx.save_for_backward(current, potential, threshold, recurrent_weight)
        return spikes, current

    @staticmethod
    @way_back
    def backward(ctx: Any, grad_spikes: Tensor | None, grad_potentials: Tensor | None) -> tuple[Tensor | None, ...]:
        potentials, potential, threshold, recurrent_weight = ctx.saved_tensors
        neuron: LIF = ctx.neuron
        _, needs_potential, needs_threshold, needs_recurrent, _ = ctx.needs_input_grad
        zero = potentials.new_zeros(())
        if grad_spikes is None:
            grad_spikes = zero.expand_as(potentials)
        grad_threshold = torch.zeros_like(threshold) if needs_threshold else None

        # Step by step, in pieces that stay in the cache; a whole window of surrogates would not.
        def through(potential: Tensor, grad_fired: Tensor, later: Tensor | None) -> Tensor:
            """Return the gradient of a potential: through its spikes, and through the next step's current."""
            if later is not None:
                if recurrent_weight is not None:
                    grad_fired = linear(later, recurrent_weight.t()).add_(grad_fired)
                if neuron.reset_gradient == "full":
                    grad_fired = torch.addcmul(grad_fired, potential, later, value=-neuron.decay)
            grad = neuron.surrogate.derivative(potential - threshold).mul_(grad_fired)
            if grad_threshold is not None:
                grad_threshold.sub_(grad.sum_to_size(threshold.shape))
            if later is not None:
                kept = torch.lt(potential, threshold, out=torch.empty_like(potential))
                grad.addcmul_(kept, later, value=neuron.decay)
            return grad

        grad_current = torch.empty_like(potentials)
        later: Tensor | None = None  # the gradient of the next step's current
        for t in range(len(potentials) - 1, -1, -1):
            grad = through(potentials[t], grad_spikes[t], later)
            if grad_potentials is not None:
                grad.add_(grad_potentials[t])
            if neuron.rectify:
                grad.mul_(potentials[t] > 0)
            later = grad_current[t].copy_(grad)

        grad_potential = grad_recurrent = None
        if needs_potential or needs_threshold:
            grad_potential = through(potential, zero.expand_as(potential), later)
        if needs_recurrent and recurrent_weight is not None:
            fired = torch.cat([potential.unsqueeze(0), potentials[:-1]]) >= threshold
            grad_recurrent = linear(grad_current.flatten(0, 1).t(), fired.flatten(0, 1).to(grad_current.dtype).t())
        return grad_current, grad_potential, grad_threshold, grad_recurrent, None
