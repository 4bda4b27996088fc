"""A spiking cerebellum that learns from the force it leaves, at the synapses of parallel fibres and Purkinje cells."""

from collections.abc import Mapping
from typing import ClassVar

import torch
from torch import Tensor

from neurorobo.clock import Clock
from neurorobo.engine import Circuit
from neurorobo.regions.driven import run_driven
from neurorobo.regions.plastic import Plastic
from neurorobo.regions.region import Probe, State
from neurorobo.regions.weights import to_grid
from neurorobo.synapses.plasticity import error_driven
from precision_interaction.regions.adaptive_cerebellum_config import AdaptiveCerebellumConfig
from precision_interaction.regions.cerebellum import INPUTS, Cerebellum

AXES = 2
BITS = 14
"""Learned currents are multiples of 2**-14: their sums are exact, and spikes do not depend on the batch."""


class AdaptiveCerebellum(Cerebellum, Plastic):
    """The cerebellum, with plastic synapses of parallel fibres on every Purkinje cell.

    A plastic synapse excites with a weight w (1 + b a), and interneurons that hear the same fibre inhibit with -w, so
    that nothing is added before learning (Albus 1971; Fujita 1982; Porrill & Dean 2007). a (axes, granule cells) is
    what is learned, between -1 and 1. b (Purkinje cells, axes) is the part that each cell has in the move of an axis,
    as its synapses on the nuclei and theirs on the output tell; the sum of its magnitudes is 1 at most, so that no
    synapse ever changes its sign. What b picks moves one axis and neither the other nor the predicted residual, to
    first order.

    Climbing fibres tell the force that the last move left. It changes a in proportion to what the granule cells did
    then: to their spikes without the mean pattern, so that a gain is not learned as an offset, plus a small share of
    that pattern, for offsets. Plastic are the cells that hear the force of their axis, and neither the other's nor a
    velocity: their activity depends on little else, and so does what is learned.

    What was learned fades within some hundred windows, and does not outlive an episode.

    State: `synapses` (batch, axes, granule cells) is a, `mean` (batch, granule cells) the mean spikes per window,
    `trace` (batch, granule cells) the spikes of the last window.
    """

    config: AdaptiveCerebellumConfig
    learned: ClassVar[tuple[str, ...]] = ()

    def __init__(self, config: AdaptiveCerebellumConfig, clock: Clock, generator: torch.Generator) -> None:
        super().__init__(config, clock, generator)
        self._before = Circuit(INPUTS, {"granule": (self.granule, [INPUTS])})
        self._behind = Circuit(
            [*INPUTS, "purkinje"],
            {"nuclei": (self.nuclei, ["purkinje", INPUTS]), "output": (self.output, ["nuclei"])},
        )

    def init_state(self, batch: int) -> State:
        """Return the state before learning."""
        cells = self.config.granule_cells
        return {
            "synapses": torch.zeros(batch, AXES, cells),
            "mean": torch.zeros(batch, cells),
            "trace": torch.zeros(batch, cells),
        }

    def step(
        self, inputs: Mapping[str, Tensor], state: State, probe: Probe | None = None
    ) -> tuple[dict[str, Tensor], State]:
        """Learn from the window before, then run one window from rest."""
        if self.config.learning_rate == 0:
            return super().step(inputs, state, probe)
        synapses = self._taught(inputs["error"], state)
        if synapses.any():
            spikes = self._run_taught(inputs, synapses, probe)
        else:  # all layers in one call
            spikes, _ = self._circuit(inputs, wanted=["granule", "output"], probe=probe)
        trace = spikes["granule"].sum(0)
        mean = to_grid(state["mean"] + (trace - state["mean"]) / self.config.habituation)
        return self._ports(spikes["output"]), {"synapses": synapses, "mean": mean, "trace": trace}

    def parallel_fibre_weights(self, state: State) -> Tensor:
        """Return the weights of the plastic synapses (batch, Purkinje cells, granule cells), 0 where there is none."""
        changes = (self.microzones() @ state["synapses"]).clamp(-1, 1)  # but for roundings, they are
        return self.config.plastic_weight * (1 + changes) * self.plastic_cells().any(0)

    def plastic_cells(self) -> Tensor:
        """Return which granule cells (axes, granule cells) the Purkinje cells can learn from."""
        source = torch.cat(
            [
                torch.full((self.input_ports[name].channels // AXES,), AXES * number + axis)
                for number, name in enumerate(INPUTS)
                for axis in range(AXES)
            ]
        )
        heard = source[self.granule.projections[0].source_index]  # type: ignore[index]

        def hears(name: str, axis: int) -> Tensor:
            return (heard == AXES * INPUTS.index(name) + axis).any(1)

        moves = hears("velocity", 0) | hears("velocity", 1)
        force = [hears("force", axis) for axis in range(AXES)]
        return torch.stack([force[0] & ~force[1] & ~moves, force[1] & ~force[0] & ~moves])

    def microzones(self) -> Tensor:
        """Return the part b (Purkinje cells, axes) that each Purkinje cell has in the move of each axis."""
        layers = (self.output, self.nuclei)
        readout, inhibition = (layer.get_parameter("projections.0.weight").detach() for layer in layers)
        by_component = readout.unflatten(0, (-1, self.config.output_neurons)).sum(1)
        effect = by_component @ inhibition  # of a Purkinje cell on each output component
        alone = effect.t() @ torch.linalg.pinv(effect @ effect.t(), hermitian=True)
        moves: Tensor = alone[:, :AXES]  # the components of the move come first
        return moves / moves.abs().sum(1).max().clamp(min=torch.finfo().tiny)

    def _taught(self, error_mN: Tensor, state: State) -> Tensor:
        """Return the synapses, faded by a window, and changed by what the climbing fibres tell of the one before."""
        felt_mN = error_mN.sign() * (error_mN.abs() - self.config.dead_zone).clamp(min=0)
        kept = (1 - self.config.forgetting) * state["synapses"]
        if not felt_mN.any():
            return kept
        cells = self.plastic_cells()
        trace, mean = (torch.where(cells, state[name].unsqueeze(1), 0.0) for name in ("trace", "mean"))
        # In double precision these sums are exact, whatever the order that the batch leads to.
        like_mean = (trace.double() * mean).sum(2) / (mean.double() * mean).sum(2).clamp(min=1)
        pattern = trace - like_mean.float().unsqueeze(2) * mean + self.config.tonic * mean
        return error_driven(kept, pattern, felt_mN, self.config.learning_rate).clamp(-1, 1)

    def _run_taught(self, inputs: Mapping[str, Tensor], synapses: Tensor, probe: Probe | None) -> dict[str, Tensor]:
        granule = self._before(inputs, wanted=["granule"], probe=probe)[0]["granule"]
        learned = to_grid(self.config.plastic_weight * synapses, BITS)
        by_axis = torch.einsum("tbg,bag->tba", granule, learned)
        zones = self.microzones()
        current = to_grid(sum(by_axis[..., axis, None] * zones[:, axis] for axis in range(AXES)), BITS)  # type: ignore[arg-type]
        purkinje = run_driven(self.purkinje, [granule], current)
        if probe is not None:
            probe("purkinje", purkinje)
        spikes, _ = self._behind({**inputs, "purkinje": purkinje}, wanted=["output"], probe=probe)
        return {"granule": granule, **spikes}

    def _ports(self, output: Tensor) -> dict[str, Tensor]:
        move, residual, *own = output.split(AXES * self.config.output_neurons, dim=-1)
        return {"move": move, "residual": residual, "velocity": own[0] if own else move}
