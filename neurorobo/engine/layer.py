"""A layer: projections onto one population of neurons."""

from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import torch
from torch import Tensor, nn
from torch.autograd import forward_ad

from neurorobo.engine.checked import CheckedWeights, check_spikes, is_finite
from neurorobo.engine.events import Population, is_native, run_events
from neurorobo.engine.kernels import Kernels, kernels
from neurorobo.engine.models import carried, is_on_native_path
from neurorobo.engine.prepared import Prepared, Stage, prepare
from neurorobo.engine.window import check_potential, run_checked, run_steps
from neurorobo.neurons import LIF, Neuron
from neurorobo.synapses import Dense, FanIn, Projection

LEAST_THRESHOLD = 0.05
"""Where the training of a threshold stops: neurons below it would fire by themselves."""

CURRENTS_AT_ONCE = 2**23
"""How many the portable path computes at once where no gradients are kept: more, and memory takes most of the time."""


class Layer(nn.Module):
    """A population of neurons, the projections that excite it, and perhaps one onto itself.

    The layer holds parameters only; its state is given and returned. It is the potential (batch, neurons) of
    :class:`LIF` neurons, and of others what their model says, with the last spikes behind it if the layer is recurrent.
    The thresholds of LIF neurons can be trained, one per neuron. What projections read are spikes, and numbers of those
    that are ``graded``.
    """

    _run_apart: ClassVar[Callable[..., Any] | None] = None

    def __init__(
        self,
        projections: Sequence[Projection],
        neuron: Neuron,
        recurrent: Dense | None = None,
        *,
        trainable_threshold: bool = False,
    ) -> None:
        super().__init__()
        sizes = {projection.targets for projection in projections}
        if recurrent is not None:
            sizes |= {recurrent.targets, recurrent.sources}
        if len(sizes) != 1:
            raise ValueError(f"the projections onto one layer must agree on its size, got {sorted(sizes)}")
        (self.neurons,) = sizes
        self.projections = nn.ModuleList(projections)
        self.recurrent = recurrent
        self.neuron = neuron
        self.checked = CheckedWeights()
        self._prepared = Prepared()
        self.threshold: nn.Parameter | None = None
        if trainable_threshold:
            if type(neuron) is not LIF:
                raise ValueError(f"only thresholds of LIF neurons can be trained, not those of {type(neuron).__name__}")
            if neuron.threshold < LEAST_THRESHOLD:
                raise ValueError(f"a trained threshold starts at {LEAST_THRESHOLD} or above, not {neuron.threshold}")
            self.threshold = nn.Parameter(torch.full((self.neurons,), neuron.threshold))

    def at_rest(self, batch: int) -> Tensor:
        """Return the state at rest, whose first dimension is the batch."""
        first = next(iter(self.projections._modules.values()))  # half the time that `self.projections[0]` takes
        weight: Tensor = first.weight  # type: ignore[assignment]
        if type(self.neuron) is LIF:
            return weight.new_zeros((batch, self.neurons))
        state = self.neuron.at_rest(batch, self.neurons).to(weight)
        if self.recurrent is not None:
            state = torch.cat([state, state.new_zeros(batch, self.neurons)], dim=1)
        return state

    @property
    def is_on_native_path(self) -> bool:
        """Whether the kernels have its neurons."""
        return is_on_native_path(self.neuron, recurrent=self.recurrent is not None)

    def fired(self, state: Tensor) -> Tensor:
        """Return who fired last, 0 or 1 (batch, neurons), without gradients; a ValueError if a state does not tell.

        Those of LIF neurons and of recurrent layers do; of soft units it is what they sent.
        """
        state, neuron = state.detach(), self.neuron
        if type(neuron) is LIF:
            threshold = neuron.threshold if self.threshold is None else self.threshold.detach()
            return (state >= threshold).to(state.dtype)
        if self.recurrent is None:
            raise ValueError(f"the state of {type(neuron).__name__} neurons that are not recurrent tells not who fired")
        return state[:, -self.neurons :]

    @torch.no_grad()
    def constrain(self) -> None:
        """Keep trained thresholds positive; the trainer calls this after each step."""
        if self.threshold is not None:
            self.threshold.clamp_(min=LEAST_THRESHOLD)

    def forward(self, inputs: Sequence[Tensor], state: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Run one window: spikes (steps, batch, sources) of each projection and the state -> spikes and the new state.

        Without a state the layer starts at rest.
        Raises a ValueError if the sizes or the types of numbers do not fit, if a spike is neither 0 nor 1, or if a
        weight or a potential is not finite; a NotImplementedError under the transforms of ``torch.func``, in forward
        mode, and where torch traces or exports. Autocast does not reach into a layer.
        """
        if not torch.compiler.is_compiling():
            return self._run(inputs, state)
        # torch.compile is to leave the engine as it is. Decorated at first sight, as the decorator imports compilers.
        if Layer._run_apart is None:
            Layer._run_apart = torch.compiler.disable(Layer._run, reason="a layer runs as it is")
        return Layer._run_apart(self, inputs, state)  # type: ignore[no-any-return]

    def _run(self, inputs: Sequence[Tensor], state: Tensor | None) -> tuple[Tensor, Tensor]:
        refuse_transforms()
        projections: list[nn.Module] = list(self.projections._modules.values())
        if self.is_on_native_path and not torch.is_grad_enabled() and (native := kernels()) is not None:
            ran = self._run_prepared(native, inputs, state)
            if ran is not None:
                return ran
        self._check_inputs(projections, inputs)
        self.check_parameters()
        if state is None:
            state = self.at_rest(inputs[0].shape[1])
        if torch._C._is_any_autocast_enabled() and torch.is_autocast_enabled(state.device.type):
            with torch.autocast(state.device.type, enabled=False):
                return self._run(inputs, state)
        if self.threshold is not None:
            self.checked.check("threshold", self.threshold)
        if self.is_on_native_path and (native := kernels()) is not None:
            ran = self._run_events(native, projections, inputs, state)
            if ran is not None:
                return ran
        steps, batch, _ = inputs[0].shape
        at_once = batch if torch.is_grad_enabled() else max(1, CURRENTS_AT_ONCE // (steps * self.neurons))
        if batch <= at_once or len(state) != batch:
            return self._run_in_torch(projections, inputs, state)
        parts = zip(*(x.split(at_once, dim=1) for x in inputs), strict=True)
        pieces = [
            self._run_in_torch(projections, part, piece, number * at_once)
            for number, (part, piece) in enumerate(zip(parts, state.split(at_once), strict=True))
        ]
        return torch.cat([spikes for spikes, _ in pieces], dim=1), torch.cat([after for _, after in pieces])

    def _run_in_torch(
        self, projections: Sequence[nn.Module], inputs: Sequence[Tensor], state: Tensor, first: int = 0
    ) -> tuple[Tensor, Tensor]:
        """Run on the portable path; ``first`` is the number of the first batch element, for errors."""
        current, recurrent_weight = self._current(projections, inputs, first), self._recurrent_weight()
        if type(self.neuron) is not LIF:
            check_state(state, first)
            return run_steps(current, state, self.neuron, recurrent_weight)
        check_potential(state, current, first)
        return run_checked(current, state, self.neuron, self.threshold, recurrent_weight)

    def _run_prepared(
        self, native: Kernels, inputs: Sequence[Tensor], state: Tensor | None
    ) -> tuple[Tensor, Tensor] | None:
        """Run a window as it was run before, or prepare it; None if it cannot be prepared, or had better not."""
        prepared = self._prepared.take()
        if prepared is None or not prepared.fits(native, inputs, (state,)):
            self._check_inputs(list(self.projections), inputs)
            self.check_parameters()
            stage = Stage(self, [(number,) for number in range(len(inputs))])
            prepared = prepare(native, (stage,), inputs, (state,))
            if prepared is None:
                return None
        ran = prepared.run(inputs, (state,), (True,), (True,))
        self._prepared.put(prepared)
        if ran is None:
            return None
        (spikes,), (last,) = ran
        assert spikes is not None and last is not None
        return spikes, last

    def _check_inputs(self, projections: Sequence[nn.Module], inputs: Sequence[Tensor]) -> None:
        if len(inputs) != len(projections):
            raise ValueError(f"a layer of {len(projections)} projections was given {len(inputs)} inputs")
        window = inputs[0].shape[:2]
        for projection, spikes in zip(projections, inputs, strict=True):
            shape = spikes.shape
            if len(shape) != 3 or shape[0] == 0:
                raise ValueError(f"a window is of (steps, batch, sources) and at least one step, got {tuple(shape)}")
            if shape[:2] != window:
                check_agreement(inputs)
            if shape[2] != projection.sources:
                raise ValueError(f"a projection of {projection.sources} sources was given the spikes of {shape[2]}")

    def check_parameters(self) -> None:
        """Raise a ValueError unless weights, indices and thresholds are of the shapes that belong to the layer."""
        for number, projection in enumerate(self.projections._modules.values()):
            self._check_weights(f"projection {number}", projection)
        if self.recurrent is not None:
            self._check_weights("recurrent", self.recurrent)
        if self.threshold is not None and self.threshold.shape != (self.neurons,):
            raise ValueError(
                f"threshold: one for each of {self.neurons} neurons, got a shape of {tuple(self.threshold.shape)}"
            )

    def _check_weights(self, name: str, projection: nn.Module | None) -> None:
        """Raise a ValueError unless the weights of one of the core's projections have the shape that belongs to it."""
        if not isinstance(projection, Projection):
            return
        sources = self.neurons if name == "recurrent" else projection.sources
        wanted = (self.neurons, sources)
        if type(projection) is FanIn:
            wanted = (self.neurons, projection.source_index.shape[-1])
            self.checked.check_index(name, projection.source_index, wanted, sources)
        elif type(projection) is not Dense:
            return
        weight = projection._parameters.get("weight")  # None if something computes it, such as a parametrization
        if weight is not None and weight.shape != wanted:
            raise ValueError(
                f"{name}: the weights from {sources} sources to {self.neurons} neurons are of {wanted}, "
                f"got {tuple(weight.shape)}"
            )

    def _recurrent_weight(self) -> Tensor | None:
        if self.recurrent is None:
            return None
        self.checked.check("recurrent", self.recurrent.weight)
        return self.recurrent.matrix()

    def _current(self, projections: Sequence[nn.Module], inputs: Sequence[Tensor], first: int) -> Tensor:
        """Return the currents (steps, batch, neurons) of all projections, by matrix products."""
        for number, (projection, spikes) in enumerate(zip(projections, inputs, strict=True)):
            weight: Tensor = projection.weight  # type: ignore[assignment]
            if spikes.dtype != weight.dtype:
                raise ValueError(f"projection {number} of {weight.dtype} was given spikes of {spikes.dtype}")
            if is_graded(projection):
                check_numbers(number, spikes, first)
            else:
                check_spikes(spikes, first)
            self.checked.check(f"projection {number}", weight)
        one, *others = zip(projections, inputs, strict=True)
        current: Tensor = one[0](one[1])
        for projection, spikes in others:
            current += projection(spikes)
        return current

    def _run_events(
        self, native: Kernels, projections: Sequence[nn.Module], inputs: Sequence[Tensor], state: Tensor
    ) -> tuple[Tensor, Tensor] | None:
        """Run on the native path; None if the tensors or the projections are not such as it takes."""
        driving: list[Tensor] = []
        weights: list[Tensor] = []
        indices: list[Tensor | None] = []
        graded: list[tuple[nn.Module, Tensor]] = []
        for number, (projection, given) in enumerate(zip(projections, inputs, strict=True)):
            kind = type(projection)
            if (kind is not Dense and kind is not FanIn) or "weight" not in projection._parameters:
                return None
            weight: Tensor = projection.weight  # type: ignore[assignment]
            if is_graded(projection):
                check_numbers(number, given)
                self.checked.check(f"projection {number}", weight)
                graded.append((projection, given))
                continue
            driving.append(given)
            weights.append(weight)
            indices.append(projection.source_index.contiguous() if kind is FanIn else None)  # type: ignore[operator]
        recurrent = None
        if self.recurrent is not None:
            if type(self.recurrent) is not Dense or "weight" not in self.recurrent._parameters:
                return None
            recurrent = self.recurrent.weight
        if not is_native(state, recurrent, *inputs, *weights, *(projection.weight for projection, _ in graded)):  # type: ignore[arg-type]
            return None
        wanted = inputs[0].shape[1], carried(self.neuron, self.neurons, recurrent=self.recurrent is not None)
        if state.shape != wanted:
            if type(self.neuron) is not LIF:
                return None  # which says it of any neuron
            raise ValueError(f"the potential is of {tuple(state.shape)} (batch, neurons), the current of {wanted}")
        current: Tensor | None = None
        for projection, given in graded:
            current = projection(given) if current is None else current + projection(given)
        population = Population(self.neuron, indices, self.checked)
        return run_events(native, population, driving, weights, state, self.threshold, recurrent, current)


def is_graded(projection: nn.Module) -> bool:
    """Return whether a projection reads numbers in place of spikes."""
    return isinstance(projection, Projection) and projection.graded


def check_numbers(projection: int, given: Tensor, first: int = 0) -> None:
    """Raise a ValueError unless what a projection is given (steps, batch, sources) is finite.

    The batch is counted from ``first`` on.
    """
    if not is_finite(given):
        step, element, source = (~given.isfinite()).nonzero()[0].tolist()
        raise ValueError(
            f"projection {projection} reads finite numbers, got {given[step, element, source].item()} from source "
            f"{source} (step {step}, batch element {first + element})"
        )


def check_state(state: Tensor, first: int = 0) -> None:
    """Raise a ValueError unless a state (batch, variables) is finite; the batch is counted from ``first`` on."""
    if not is_finite(state):
        place = (~state.isfinite()).nonzero()[0].tolist()
        value = state[tuple(place)].item()
        raise ValueError(f"a potential is a finite number, got {value} at {[place[0] + first, *place[1:]]}")


def check_agreement(inputs: Sequence[Tensor]) -> None:
    """Raise a ValueError unless the windows (steps, batch, sources) agree in steps and batch."""
    windows = sorted({tuple(spikes.shape[:-1]) for spikes in inputs})
    if len(windows) > 1:
        raise ValueError(f"the inputs of a layer must agree in steps and batch, got {windows}")


def refuse_transforms() -> None:
    """Raise a NotImplementedError where torch would look through a layer and see nothing of its kernels."""
    if torch._C._are_functorch_transforms_active():
        raise NotImplementedError("a layer runs under autograd, but not under vmap, grad or others of torch.func")
    if forward_ad._current_level >= 0:
        raise NotImplementedError("a layer has no derivatives in forward mode (torch.autograd.forward_ad)")
    if torch._C._get_tracing_state() is not None or torch.compiler.is_exporting():
        raise NotImplementedError("a layer can be neither traced nor exported; save its weights instead")
