"""One whole window of a spiking layer: the scan over time, forwards and backwards.

The input currents of all steps come from one matrix product (see :mod:`neurorobo.engine.layer`); what is left is this
scan. It is one hand-written autograd function in place of a graph of several operations per step: it keeps only the
potentials and recomputes spikes and surrogates on the way back.
"""

from typing import Any

import torch
from torch import Tensor

from neurorobo.engine.checked import CheckedWeights, is_finite, steps_at_once
from neurorobo.engine.events import Population, is_native, run_events, way_back
from neurorobo.engine.kernels import kernels
from neurorobo.engine.models import carried, is_on_native_path
from neurorobo.neurons import LIF, Neuron
from neurorobo.synapses.product import linear, subtract_linear


def run_window(
    current: Tensor,
    potential: Tensor,
    neuron: LIF,
    threshold: Tensor | None = None,
    recurrent_weight: Tensor | None = None,
) -> tuple[Tensor, Tensor]:
    """Run a layer of neurons through a window.

    ``current`` (steps, batch, neurons) is given away: it is overwritten, perhaps by the spikes that are returned.
    ``potential`` (batch, neurons) is the potential at the end of
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
        _check_recurrent(recurrent_weight, neurons)
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


def _check_recurrent(weight: Tensor, neurons: int) -> None:
    if weight.shape != (neurons, neurons):
        raise ValueError(
            f"the recurrent weights of {neurons} neurons are of {(neurons, neurons)}, got {tuple(weight.shape)}"
        )


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
    if not torch.is_grad_enabled():
        spikes = current.detach()  # in the same memory: fresh memory would take as long as a step or more
        return spikes, _scan(spikes, potential, threshold, recurrent_weight, neuron, spikes)
    spikes, last, _ = _Window.apply(current, potential, threshold, recurrent_weight, neuron)  # type: ignore[no-untyped-call]
    return spikes, last


def run_neurons(
    current: Tensor,
    state: Tensor,
    neuron: Neuron,
    threshold: Tensor | None = None,
    recurrent_weight: Tensor | None = None,
) -> tuple[Tensor, Tensor]:
    """Run neurons of any model through a window, the fastest way there is; the current is given away.

    Of LIF neurons it is :func:`run_window`; of others all else is as in :func:`run_steps`, and a threshold is refused
    with a ValueError.
    """
    if type(neuron) is LIF:
        return run_window(current, state, neuron, threshold, recurrent_weight)
    if threshold is not None:
        raise ValueError(f"only LIF neurons can be given thresholds, not those of {type(neuron).__name__}")
    native, recurrent = kernels(), recurrent_weight is not None
    if (
        native is None
        or not is_on_native_path(neuron, recurrent=recurrent)
        or not is_native(current, state, recurrent_weight)
        or current.dim() != 3
        or state.shape != (current.shape[1], carried(neuron, current.shape[2], recurrent=recurrent))
    ):
        return run_steps(current, state, neuron, recurrent_weight)
    _check_window(current)
    if recurrent_weight is not None:
        _check_recurrent(recurrent_weight, current.shape[2])
    population = Population(neuron, (), CheckedWeights())
    return run_events(native, population, (), (), state, None, recurrent_weight, current.contiguous())


def run_steps(
    current: Tensor, state: Tensor, neuron: Neuron, recurrent_weight: Tensor | None = None
) -> tuple[Tensor, Tensor]:
    """Run a layer of neurons of any model through a window, step by step; slower than :func:`run_window`.

    As there, but gradients are autograd's, nothing is overwritten, and ``state`` (batch, variables) is the neuron's.
    With a ``recurrent_weight`` it has the last spikes (batch, neurons) behind the neuron's variables. Raises a
    ValueError if sizes or types of numbers do not fit, or if the neuron returns spikes or a state of another size.
    """
    _check_window(current)
    _, batch, neurons = current.shape
    if len(state) != batch:
        raise ValueError(f"the state is of a batch of {len(state)}, the current of {batch}")
    variables = neuron.at_rest(1, neurons).shape[1] + (0 if recurrent_weight is None else neurons)
    if state.shape != (batch, variables):
        raise ValueError(
            f"the state of {neurons} neurons {type(neuron).__name__} is of {(batch, variables)} (batch, variables), "
            f"got {tuple(state.shape)}"
        )
    if state.dtype != current.dtype:
        raise ValueError(f"a state of {state.dtype} does not go with a current of {current.dtype}")
    fired: Tensor | None = None
    if recurrent_weight is not None:
        _check_recurrent(recurrent_weight, neurons)
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


def _scan(
    current: Tensor,
    potential: Tensor,
    threshold: Tensor,
    recurrent_weight: Tensor | None,
    neuron: LIF,
    spikes: Tensor,
) -> Tensor:
    """Write the spikes and return the last potential; the current is overwritten by the potentials, negated.

    Negated, neurons keep what is above the negated threshold, which is one operation if they have it in common. The
    spikes may be written over the current.
    """
    before, floor = -potential, -threshold
    shared_floor = floor.item() if floor.dim() == 0 else None
    # A plain number would be made a tensor at each step, which takes longer than to multiply with it.
    decay = torch.tensor(neuron.decay, dtype=torch.promote_types(current.dtype, torch.float32), device=current.device)
    kept, fired = torch.empty_like(before), torch.empty_like(before)
    steps = steps_at_once(current)
    # Comparisons write 0 and 1 as floats: several times faster than masks and `where`.
    for piece, firing in zip(current.split(steps), spikes.split(steps), strict=True):
        for now in piece.neg_().unbind():
            if recurrent_weight is not None:
                subtract_linear(now, torch.le(before, floor, out=fired), recurrent_weight)
            if shared_floor is not None:
                torch.threshold(before, shared_floor, 0.0, out=kept)
            else:
                torch.gt(before, floor, out=kept).mul_(before)
            now.add_(kept.mul_(decay))  # rounded twice, on every processor alike
            if neuron.rectify:
                now.clamp_max_(0)
            before = now
        before = before.clone()
        torch.le(piece, floor, out=firing)
    return 0 - before  # no zero is negative


class _Window(torch.autograd.Function):
    """:func:`_scan`, differentiable in all its tensors."""

    @staticmethod
    def forward(
        ctx: Any,
        current: Tensor,
        potential: Tensor,
        threshold: Tensor,
        recurrent_weight: Tensor | None,
        neuron: LIF,
    ) -> tuple[Tensor, Tensor, Tensor]:
        ctx.set_materialize_grads(False)
        ctx.mark_dirty(current)
        ctx.neuron = neuron
        spikes = torch.empty_like(current)
        last = _scan(current, potential, threshold, recurrent_weight, neuron, spikes)
        ctx.save_for_backward(current, potential, threshold, recurrent_weight)
        return spikes, last, current

    @staticmethod
    @way_back
    def backward(
        ctx: Any, grad_spikes: Tensor | None, grad_last: Tensor | None, _: Tensor | None
    ) -> tuple[Tensor | None, ...]:
        negated, potential, threshold, recurrent_weight = ctx.saved_tensors
        neuron: LIF = ctx.neuron
        _, needs_potential, needs_threshold, needs_recurrent, _ = ctx.needs_input_grad
        floor = -threshold
        zero = negated.new_zeros(()).expand_as(negated)
        grad_spikes = zero if grad_spikes is None else grad_spikes
        grad_threshold = torch.zeros_like(threshold) if needs_threshold else None

        def through(
            negated: Tensor, grad_spikes: Tensor, last: Tensor | None, later: Tensor, grads: Tensor, *, rectify: bool
        ) -> Tensor:
            """Write the gradients of some steps' currents, given that of the next step's; return that of the first."""
            if recurrent_weight is not None:
                grad_spikes = linear(later, recurrent_weight.t()) + grad_spikes
            slopes = neuron.surrogate.derivative(negated - floor)  # the same on both sides of the threshold
            carried = torch.gt(negated, floor, out=torch.empty_like(negated))
            if neuron.reset_gradient == "full":
                carried.addcmul_(slopes, negated)
            carried.mul_(neuron.decay)
            torch.mul(slopes, grad_spikes, out=grads)
            if last is not None:
                grads[-1].add_(last)
            above = torch.lt(negated, 0, out=torch.empty_like(negated)) if rectify else None
            following = later
            for t in range(len(grads) - 1, -1, -1):
                grad = grads[t].addcmul_(carried[t], following)
                if above is not None:
                    grad.mul_(above[t])
                following = grad
            if grad_threshold is not None:
                if neuron.reset_gradient == "full":
                    resets = torch.cat([grads[1:], later.unsqueeze(0)]).mul_(negated)
                    grad_spikes = torch.add(grad_spikes, resets, alpha=neuron.decay)
                grad_threshold.sub_(slopes.mul_(grad_spikes).sum_to_size(threshold.shape))
            return following

        grad_current, later = torch.empty_like(negated), torch.zeros_like(potential)
        steps = steps_at_once(negated) if recurrent_weight is None else 1
        pieces = zip(*(x.split(steps) for x in (negated, grad_spikes, grad_current)), strict=True)
        for piece, grads, into in reversed(list(pieces)):
            later = through(piece, grads, grad_last, later, into, rectify=neuron.rectify)
            grad_last = None
        grad_potential = grad_recurrent = None
        if needs_potential or needs_threshold:  # which was rectified, if at all, by the window that it came from
            into = torch.empty_like(negated[:1])
            grad_potential = through(-potential.unsqueeze(0), zero[:1], None, later, into, rectify=False)
        if needs_recurrent:
            fired = torch.cat([-potential.unsqueeze(0), negated[:-1]]).le_(floor)
            grad_recurrent = linear(grad_current.flatten(0, 1).t(), fired.flatten(0, 1).t())
        return grad_current, grad_potential, grad_threshold, grad_recurrent, None
