"""One window of a layer on the native path: forwards driven by events, backwards by hand.

Only those synapses are visited whose source fires. The gradients of weights are summed over events too; those of inputs
are dense and come from torch's matrix product, as do the currents of sources that fire too often for events to pay.
"""

from collections.abc import Callable, Sequence
from functools import cache, wraps
from typing import Any, NamedTuple

import torch
from torch import Tensor

from neurorobo.engine.checked import CheckedWeights
from neurorobo.engine.kernels import Drive, Events, Kernels, Packed
from neurorobo.engine.models import native_model
from neurorobo.neurons import LIF, Neuron
from neurorobo.synapses.product import linear

DENSE_ABOVE = 0.7
"""The share of sources that fire per step above which currents come from a matrix product instead of events.

Where the two take the same time depends on how well torch's product suits the processor: at 0.8 on those that it suits
best, above 1 on others.
"""

FEW_SOURCES = 64
"""How many sources a projection has at most for which events pay at any density.

A product would write and read a current for each step of each neuron, to save a few additions.
"""


def most_events(rows: int, sources: int) -> float:
    """Return how many events of ``rows`` (steps x batch elements) pay; for more, a matrix product does."""
    share = DENSE_ABOVE if sources > FEW_SOURCES else 1.0
    return share * rows * sources


class Population(NamedTuple):
    """What stays from window to window: the neuron, the index of each fan-in's sources, and the weights as checked."""

    neuron: Neuron
    indices: Sequence[Tensor | None]
    checked: CheckedWeights


def is_batched(tensor: Tensor) -> bool:
    """Return whether a tensor stands for several, as under vmap."""
    return torch._C._functorch.is_batchedtensor(tensor) or torch._C._functorch.is_legacy_batchedtensor(tensor)


def way_back(backward: Callable[..., Any]) -> Callable[..., Any]:
    """Make a backward function refuse, with a NotImplementedError, what it cannot do; autocast does not reach it."""

    @wraps(backward)
    def run(ctx: Any, *grads: Tensor | None) -> Any:
        if torch.is_grad_enabled():
            raise NotImplementedError("the gradients of a layer cannot be differentiated again (create_graph=True)")
        if any(grad is not None and is_batched(grad) for grad in grads):
            raise NotImplementedError(
                "the gradients of a layer come one by one, not as batches (is_grads_batched=True)"
            )
        if not torch._C._is_any_autocast_enabled():
            return backward(ctx, *grads)
        device = next((grad.device.type for grad in grads if grad is not None), "cpu")
        with torch.autocast(device, enabled=False):
            return backward(ctx, *grads)

    return run


def is_native(*tensors: Tensor | None) -> bool:
    """Return whether the kernels can read the memory of all tensors: float32 on the CPU."""
    for tensor in tensors:  # noqa: SIM110 (each microsecond counts here)
        if tensor is not None and not (tensor.dtype is torch.float32 and tensor.is_cpu):
            return False
    return True


def run_events(
    native: Kernels,
    population: Population,
    inputs: Sequence[Tensor],
    weights: Sequence[Tensor],
    state: Tensor,
    threshold: Tensor | None,
    recurrent_weight: Tensor | None,
    current: Tensor | None = None,
) -> tuple[Tensor, Tensor]:
    """Run a layer through a window and return its spikes (steps, batch, neurons) and the state after it.

    ``inputs`` are the spikes (steps, batch, sources) of each projection, ``weights`` its (targets, sources), or
    (targets, fan_in) with an index; ``current`` (steps, batch, neurons), if given, is added and overwritten, by the
    potentials of LIF neurons. ``state`` is that of a :class:`neurorobo.engine.Layer`, ``threshold`` is for LIF neurons.
    All is float32 on the CPU. Raises a ValueError if a spike is neither 0 nor 1 or a weight is not finite.
    """
    if threshold is None and isinstance(population.neuron, LIF):
        threshold = number_tensor(population.neuron.threshold)
    if torch.is_grad_enabled():
        given = (current, state, threshold, recurrent_weight, *inputs, *weights)
        if any(tensor is not None and tensor.requires_grad for tensor in given):
            spikes, last, _ = _Window.apply(native, population, *given)  # type: ignore[no-untyped-call]
            return spikes, last
    ran = _run(native, population, current, state, threshold, recurrent_weight, *inputs, *weights, training=False)
    return ran.spikes, ran.last


class _Ran(NamedTuple):
    """A window that was run: its results, and what the way back needs. A dense projection has no events."""

    spikes: Tensor
    last: Tensor
    potentials: Tensor | None
    before: Tensor | None
    events: Sequence[Events | None]
    fired: Tensor | None


def _run(
    native: Kernels,
    population: Population,
    current: Tensor | None,
    state: Tensor,
    threshold: Tensor | None,
    recurrent_weight: Tensor | None,
    *inputs_and_weights: Tensor,
    training: bool,
) -> _Ran:
    checked, count = population.checked, len(population.indices)
    inputs, weights = inputs_and_weights[:count], inputs_and_weights[count:]
    steps, batch = len(inputs[0] if current is None else current), len(state)
    neurons = len(weights[0]) if current is None else current.shape[2]
    potentials = current
    drives: list[Drive] = []
    kept: list[Events | None] = []
    for number, (spikes, weight, index) in enumerate(zip(inputs, weights, population.indices, strict=True)):
        name = f"projection {number}"
        events = native.pack_spikes(spikes)
        if index is None and events.ones > most_events(steps * batch, events.sources):
            checked.check(name, weight)
            product = linear(spikes, weight)
            current = product if current is None else current.add_(product)
            kept.append(None)
            continue
        if index is None:
            drives.append(Drive(events, checked.packed(name, weight, native, narrow=not training), None))
        else:
            checked.check(name, weight)
            drives.append(Drive(events, Packed(weight.contiguous()), index.contiguous()))
        kept.append(events)
    recurrent = None
    if recurrent_weight is not None:
        recurrent = checked.packed("recurrent", recurrent_weight, native, narrow=not training)
    last = state.clone().contiguous()
    spikes = native.empty((steps, batch, neurons))
    if potentials is None and training:
        potentials = native.empty(spikes.shape) if current is None else current
    before = None
    if training and (model := native_model(population.neuron)) is not None:
        before = native.empty((steps, batch, model.variables, neurons))
    fired = native.run_window(
        drives,
        current,
        recurrent,
        population.neuron,
        None if threshold is None else threshold.contiguous(),
        last,
        spikes,
        potentials,
        before,
    )
    return _Ran(spikes, last, potentials, before, kept, fired)


class _Window(torch.autograd.Function):
    """:func:`_run`, differentiable in all its tensors."""

    @staticmethod
    def forward(
        ctx: Any,
        native: Kernels,
        population: Population,
        current: Tensor | None,
        state: Tensor,
        threshold: Tensor | None,
        recurrent_weight: Tensor | None,
        *inputs_and_weights: Tensor,
    ) -> tuple[Tensor, Tensor, Tensor | None]:
        ctx.set_materialize_grads(False)
        if current is not None:
            ctx.mark_dirty(current)
        ran = _run(native, population, current, state, threshold, recurrent_weight, *inputs_and_weights, training=True)
        ctx.native, ctx.population = native, population
        count = len(population.indices)
        inputs, weights = inputs_and_weights[:count], inputs_and_weights[count:]
        ctx.sources = [
            None if events is None else (events.sources, events.ones) for events in ran.events
        ]  # what the events are, but for their words
        words = [spikes if events is None else events.words for spikes, events in zip(inputs, ran.events, strict=True)]
        ctx.save_for_backward(
            ran.potentials, ran.before, state, threshold, recurrent_weight, ran.fired, *words, *weights
        )
        return ran.spikes, ran.last, current

    @staticmethod
    @way_back
    def backward(
        ctx: Any, grad_spikes: Tensor | None, grad_last: Tensor | None, _: Tensor | None
    ) -> tuple[Tensor | None, ...]:
        potentials, before, state, threshold, recurrent_weight, fired, *rest = ctx.saved_tensors
        native: Kernels = ctx.native
        neuron, indices = ctx.population.neuron, ctx.population.indices
        words, weights = rest[: len(indices)], rest[len(indices) :]
        _, _, needs_current, needs_state, needs_threshold, needs_recurrent, *needs = ctx.needs_input_grad
        grad_spikes = potentials.new_zeros(()).expand_as(potentials) if grad_spikes is None else grad_spikes
        grad_last = None if grad_last is None else grad_last.contiguous()
        if isinstance(neuron, LIF):
            gradients = _back_through_lif(
                native,
                neuron,
                _Saved(potentials, None, state, threshold, recurrent_weight),
                grad_spikes,
                grad_last,
                needs_state=needs_state,
                needs_threshold=needs_threshold,
            )
        else:
            saved = _Saved(potentials, before, state, None, recurrent_weight)
            gradients = _back_through_model(native, neuron, saved, grad_spikes, grad_last)
        grad_current = gradients.current
        grad_recurrent = None
        if needs_recurrent:
            steps, batch, neurons = potentials.shape
            events = Events(fired[:-1], neurons, steps * batch * neurons // 8)
            grad_recurrent = native.weight_gradient(events, grad_current, None)
        grad_inputs: list[Tensor | None] = []
        grad_weights: list[Tensor | None] = []
        flat = grad_current.flatten(0, 1)
        for number, (spikes, weight, index, known) in enumerate(zip(words, weights, indices, ctx.sources, strict=True)):
            needs_input, needs_weight = needs[number], needs[len(indices) + number]
            grad_input = grad_weight = None
            if needs_input:
                matrix = weight
                if index is not None:
                    matrix = weight.new_zeros(len(weight), known[0]).scatter_(1, index, weight)
                grad_input = linear(flat, matrix.t()).unflatten(0, grad_current.shape[:2])
            if needs_weight and known is None:
                grad_weight = linear(flat.t(), spikes.flatten(0, 1).t())
            elif needs_weight:
                grad_weight = native.weight_gradient(Events(spikes, *known), grad_current, index)
            grad_inputs.append(grad_input)
            grad_weights.append(grad_weight)
        return (
            None,
            None,
            grad_current if needs_current else None,
            gradients.state if needs_state else None,
            gradients.threshold,
            grad_recurrent,
            *grad_inputs,
            *grad_weights,
        )


class _Saved(NamedTuple):
    """What the way back through the neurons of a window needs: see :meth:`Kernels.run_window`."""

    potentials: Tensor
    before: Tensor | None
    state: Tensor
    threshold: Tensor | None
    recurrent_weight: Tensor | None


class _Gradients(NamedTuple):
    """Those of the currents (steps, batch, neurons), the state before the window and the thresholds."""

    current: Tensor
    state: Tensor | None
    threshold: Tensor | None


def _back_through_lif(
    native: Kernels,
    neuron: LIF,
    saved: _Saved,
    grad_spikes: Tensor,
    grad_last: Tensor | None,
    *,
    needs_state: bool,
    needs_threshold: bool,
) -> _Gradients:
    potentials, _, potential, threshold, recurrent_weight = saved
    assert threshold is not None
    flat_threshold = threshold.contiguous()
    grad_current = native.empty(potentials.shape)
    grad_threshold = potential.new_zeros(potential.shape) if needs_threshold else None  # contiguous at any rate

    def back(
        potentials: Tensor, grads: Tensor, last: Tensor | None, later: Tensor | None, into: Tensor, rectify: bool
    ) -> None:
        """Go back through some steps, of a recurrent layer one by one."""
        if later is not None and recurrent_weight is not None:
            grads = linear(later, recurrent_weight.t()).add_(grads[0]).unsqueeze(0)
        native.scan_back(neuron, flat_threshold, potentials, grads, last, later, into, grad_threshold, rectify=rectify)

    if recurrent_weight is None:
        back(potentials, grad_spikes, grad_last, None, grad_current, neuron.rectify)
    else:
        later: Tensor | None = None
        for t in range(len(potentials) - 1, -1, -1):
            now = slice(t, t + 1)
            back(potentials[now], grad_spikes[now], grad_last, later, grad_current[now], neuron.rectify)
            grad_last, later = None, grad_current[t]
    grad_potential = None
    if needs_state or needs_threshold:  # which was rectified, if at all, by the window that it came from
        grad_potential = torch.empty_like(potentials[0])
        before, nothing = potential.contiguous().unsqueeze(0), potentials.new_zeros(()).expand_as(potentials[:1])
        back(before, nothing, None, grad_current[0], grad_potential.unsqueeze(0), False)
    if grad_threshold is not None:
        grad_threshold = grad_threshold.sum_to_size(threshold.shape)
    return _Gradients(grad_current, grad_potential, grad_threshold)


def _back_through_model(
    native: Kernels, neuron: Neuron, saved: _Saved, grad_spikes: Tensor, grad_last: Tensor | None
) -> _Gradients:
    current, before, state, _, recurrent_weight = saved
    assert before is not None
    steps, _, neurons = current.shape
    grad_current = native.empty(current.shape)
    if grad_last is None:
        grad_last = state.new_zeros(state.shape)  # contiguous at any rate
    if recurrent_weight is None:
        grad_state = grad_last.clone()
        native.model_back(neuron, before, current, grad_spikes, grad_state, grad_current)
        return _Gradients(grad_current, grad_state, None)
    of_fired = grad_last[:, -neurons:]
    grad_state = grad_last[:, :-neurons].clone(memory_format=torch.contiguous_format)  # it is overwritten
    for t in range(steps - 1, -1, -1):
        now = slice(t, t + 1)
        grads = (grad_spikes[t] + of_fired).unsqueeze(0)
        native.model_back(neuron, before[now], current[now], grads, grad_state, grad_current[now])
        of_fired = linear(grad_current[t], recurrent_weight.t())
    return _Gradients(grad_current, torch.cat([grad_state, of_fired], dim=1), None)


@cache
def number_tensor(value: float) -> Tensor:
    """Return a threshold as a tensor, which may be kept for a way back."""
    with torch.inference_mode(False):
        return torch.tensor(value, dtype=torch.float32, device="cpu")
