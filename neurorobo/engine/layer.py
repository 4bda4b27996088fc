"""A layer: projections onto one population of neurons."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from neurorobo.engine.checked import CheckedWeights, check_spikes
from neurorobo.engine.events import Population, is_native, run_events
from neurorobo.engine.kernels import Kernels, kernels
from neurorobo.engine.window import run_steps, run_window
from neurorobo.neurons import LIF, Neuron
from neurorobo.synapses import Dense, FanIn, Projection

LEAST_THRESHOLD = 0.05
"""Where the training of a threshold stops: neurons below it would fire by themselves."""


class Layer(nn.Module):
    """A population of neurons, the projections that excite it, and perhaps one onto itself.

    The layer holds parameters only; its state is given and returned. It is the potential (batch, neurons) of
    :class:`LIF` neurons, and of others what their model says, with the last spikes behind it if the layer is recurrent.
    The thresholds of LIF neurons can be trained, one per neuron.
    """

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
        self._checked = CheckedWeights()
        self.threshold: nn.Parameter | None = None
        if trainable_threshold:
            if type(neuron) is not LIF:
                raise ValueError(f"only thresholds of LIF neurons can be trained, not those of {type(neuron).__name__}")
            if neuron.threshold < LEAST_THRESHOLD:
                raise ValueError(f"a trained threshold starts at {LEAST_THRESHOLD} or above, not {neuron.threshold}")
            self.threshold = nn.Parameter(torch.full((self.neurons,), neuron.threshold))

    def at_rest(self, batch: int) -> Tensor:
        """Return the state at rest, whose first dimension is the batch."""
        weight: Tensor = self.projections[0].weight  # type: ignore[assignment]
        state = self.neuron.at_rest(batch, self.neurons).to(weight)
        if self.recurrent is not None and type(self.neuron) is not LIF:
            state = torch.cat([state, state.new_zeros(batch, self.neurons)], dim=1)
        return state

    @torch.no_grad()
    def constrain(self) -> None:
        """Keep trained thresholds positive; the trainer calls this after each step."""
        if self.threshold is not None:
            self.threshold.clamp_(min=LEAST_THRESHOLD)

    def forward(self, inputs: Sequence[Tensor], state: Tensor) -> tuple[Tensor, Tensor]:
        """Run one window: spikes (steps, batch, sources) of each projection and the state -> spikes and the new state.

        Raises a ValueError if their numbers of steps, batches or sources do not fit, if a spike is neither 0 nor 1, or
        if a weight is not finite; a NotImplementedError under the transforms of ``torch.func``.
        """
        if torch._C._are_functorch_transforms_active():
            raise NotImplementedError("a layer runs under autograd, but not under vmap, grad or others of torch.func")
        self._check_sizes(inputs)
        if self.threshold is not None:
            self._checked.check("threshold", self.threshold)
        if type(self.neuron) is LIF:
            native = kernels()
            if native is not None and (ran := self._run_events(native, inputs, state)) is not None:
                return ran
        for spikes in inputs:
            check_spikes(spikes)
        current: Tensor | None = None
        for number, (projection, spikes) in enumerate(zip(self.projections, inputs, strict=True)):
            self._checked.check(f"projection {number}", projection.weight)  # type: ignore[arg-type]
            current = projection(spikes) if current is None else current.add_(projection(spikes))
        assert current is not None
        recurrent = None if self.recurrent is None else self.recurrent.matrix()
        if self.recurrent is not None:
            self._checked.check("recurrent", self.recurrent.weight)
        if type(self.neuron) is LIF:
            return run_window(current, state, self.neuron, self.threshold, recurrent)
        return run_steps(current, state, self.neuron, recurrent)

    def _check_sizes(self, inputs: Sequence[Tensor]) -> None:
        if len(inputs) != len(self.projections):
            raise ValueError(f"a layer of {len(self.projections)} projections was given {len(inputs)} inputs")
        if len(windows := {tuple(spikes.shape[:-1]) for spikes in inputs}) > 1:
            raise ValueError(f"the inputs of a layer must agree in steps and batch, got {sorted(windows)}")
        for projection, spikes in zip(self.projections, inputs, strict=True):
            if spikes.dim() != 3 or len(spikes) == 0:
                raise ValueError(
                    f"a window is of (steps, batch, sources) and at least one step, got {tuple(spikes.shape)}"
                )
            if spikes.shape[2] != projection.sources:
                raise ValueError(
                    f"a projection of {projection.sources} sources was given the spikes of {spikes.shape[2]}"
                )

    def _run_events(self, native: Kernels, inputs: Sequence[Tensor], state: Tensor) -> tuple[Tensor, Tensor] | None:
        """Run on the native path; None if the tensors are not what it takes."""
        weights: list[Tensor] = []
        indices: list[Tensor | None] = []
        for projection in self.projections:
            if type(projection).forward is not Projection.forward:
                return None
            fan_in = type(projection) is FanIn
            weights.append(projection.weight if fan_in else projection.matrix())  # type: ignore[arg-type, operator]
            indices.append(projection.source_index if fan_in else None)  # type: ignore[arg-type]
        recurrent = None if self.recurrent is None else self.recurrent.matrix()
        given = (state, *inputs, *weights) if recurrent is None else (state, recurrent, *inputs, *weights)
        if not all(is_native(tensor) for tensor in given):
            return None
        if state.shape != (wanted := (inputs[0].shape[1], self.neurons)):
            raise ValueError(
                f"the potential is of {tuple(state.shape)} (batch, neurons), the current of {wanted}"
            )
        population = Population(self.neuron, indices, self._checked)  # type: ignore[arg-type]
        return run_events(native, population, inputs, weights, state, self.threshold, recurrent)
