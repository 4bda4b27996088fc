"""A layer: projections onto one population of neurons."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from neurorobo.engine.window import run_steps, run_window
from neurorobo.neurons import LIF, Neuron
from neurorobo.synapses import Dense, Projection

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

        Raises a ValueError if their numbers of steps, batches or sources do not fit.
        """
        if len(windows := {tuple(spikes.shape[:-1]) for spikes in inputs}) > 1:
            raise ValueError(f"the inputs of a layer must agree in steps and batch, got {sorted(windows)}")
        first, *rest = zip(self.projections, inputs, strict=True)
        current = first[0](first[1])
        for projection, spikes in rest:
            current += projection(spikes)
        recurrent = None if self.recurrent is None else self.recurrent.matrix()
        if type(self.neuron) is LIF:
            return run_window(current, state, self.neuron, self.threshold, recurrent)
        return run_steps(current, state, self.neuron, recurrent)
