"""A layer: projections onto one population of neurons."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from neurorobo.engine.window import run_window
from neurorobo.neurons import LIF
from neurorobo.synapses import Dense, Projection


class Layer(nn.Module):
    """A population of neurons, the projections that excite it, and perhaps one onto itself.

    The layer holds parameters only; its state is the potential (batch, neurons), given and returned.
    """

    def __init__(
        self,
        projections: Sequence[Projection],
        neuron: LIF,
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
        self.threshold = nn.Parameter(torch.full((self.neurons,), neuron.threshold)) if trainable_threshold else None

    def at_rest(self, batch: int) -> Tensor:
        """Return the resting potential (batch, neurons)."""
        return self.projections[0].weight.new_zeros(batch, self.neurons)  # type: ignore[operator]

    def forward(self, inputs: Sequence[Tensor], potential: Tensor) -> tuple[Tensor, Tensor]:
        """Run one window: spikes (steps, batch, sources) of each projection and the potential -> spikes and the new
        potential."""
        first, *rest = zip(self.projections, inputs, strict=True)
        current = first[0](first[1])
        for projection, spikes in rest:
            current += projection(spikes)
        recurrent = None if self.recurrent is None else self.recurrent.matrix()
        return run_window(current, potential, self.neuron, self.threshold, recurrent)
