"""The shipped brain regions as networks, and the spikes that reach them in recorded insertions."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import torch
from networks import Network, Population, run
from precision_interaction.regions.cerebellum import INPUTS as MOSSY_FIBRES
from precision_interaction.regions.cerebellum import Cerebellum
from precision_interaction.regions.hippocampus import Hippocampus
from precision_interaction.regions.prefrontal_cortex import PrefrontalCortex
from torch import Tensor

from neurorobo.config.experiment import load_experiment
from neurorobo.engine import Layer
from neurorobo.experiment.build import build_brain, build_task
from neurorobo.experiment.closed_loop import run_episodes
from neurorobo.experiment.recorder import Sample
from neurorobo.graph.plan import Plan
from neurorobo.neurons import LIF
from neurorobo.regions.region import Region
from neurorobo.synapses import FanIn

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "peg_in_hole.yaml"
FIRST_SEED = 1000

Wiring = tuple[Sequence[tuple[str, ...]], Sequence[Population], Sequence[str], int]
"""The ports of each input side by side, the populations, the ports that the last one's spikes leave by, and the batch
in training."""


def shipped_networks(episodes: int) -> list[Network]:
    """Return H, P and C with the weights of the example, and with the windows of so many insertions.

    Raises RuntimeError if a network's spikes are not those of its region.
    """
    experiment = load_experiment(EXAMPLE)
    brain, task = build_brain(experiment), build_task(experiment)
    heard = _Heard(brain.plan)
    run_episodes(brain, task, range(FIRST_SEED, FIRST_SEED + episodes), recorders=[heard])
    networks = []
    for letter, name in (("H", "hippocampus"), ("P", "prefrontal_cortex"), ("C", "cerebellum")):
        region = brain.region(name)
        inputs, populations, outputs, training_batch = _wiring(region)
        spikes = {port: torch.cat(windows, dim=1) for port, windows in heard.spikes[name].items()}
        windows = [torch.cat([spikes[port] for port in ports], dim=-1) for ports in inputs]
        sizes = tuple(window.shape[-1] for window in windows)
        network = Network(letter, "shipped", sizes, populations, training_batch, windows)
        _compare(network, region, spikes, outputs)
        networks.append(network)
    return networks


class _Heard:
    """Keeps the spikes that reach each region, of the episodes that are running, by its ports."""

    most_neurons = 0

    def __init__(self, plan: Plan) -> None:
        self.spikes: dict[str, dict[str, list[Tensor]]] = {}
        self._regions = {use.name: use.region for use in plan.uses()}

    def sample(self, sample: Sample) -> None:
        """Take what each iteration of each step was given."""
        running = torch.from_numpy(sample.running)
        for step, iterations in sample.inputs.items():
            ports = self.spikes.setdefault(self._regions[step], {})
            for name, value in (pair for given in iterations for pair in given.items()):
                if value.dim() == 3:  # numbers have no steps
                    ports.setdefault(name, []).append(value[:, running].to(torch.uint8))


def _wiring(region: Region) -> Wiring:
    ports = tuple(region.input_ports)
    if isinstance(region, Hippocampus):
        hidden, output = _population(region.hidden, 0, 1, 2), _population(region.output, 3)
        return [(port,) for port in ports], [hidden, output], tuple(region.output_ports), 64
    if isinstance(region, Cerebellum):
        cells = [
            _population(region.granule, 0),
            _population(region.purkinje, 1),
            _population(region.nuclei, 2, 0),
            _population(region.output, 3),
        ]
        return [MOSSY_FIBRES], cells, ("move", "residual"), 16
    assert isinstance(region, PrefrontalCortex)
    blocks = [
        _population(region.prediction.layer, 1),
        _population(region.terminal.layer, 2),
        _population(region.general, 0, 1, 2, 3),
    ]
    first, *rest = region.later
    later = [_population(first, 4, 5, 6), *(_population(layer, number) for number, layer in enumerate(rest, start=7))]
    return [ports[:1], ports[1:3], ports[3:5], ports[5:]], [*blocks, *later], ("speed", "beta"), 64


def _population(layer: torch.nn.Module, *reads: int) -> Population:
    assert isinstance(layer, Layer)
    assert isinstance(layer.neuron, LIF)
    weights, index = [], None
    for projection in layer.projections:
        weights.append(projection.weight.detach())  # type: ignore[operator]
        if isinstance(projection, FanIn):
            index = projection.source_index
    return Population(
        reads,
        torch.cat(weights, dim=1),
        index,
        None if layer.recurrent is None else layer.recurrent.weight.detach(),
        layer.neuron.threshold if layer.threshold is None else layer.threshold.detach(),
        layer.neuron.decay,
        layer.neuron.rectify,
    )


def _compare(network: Network, region: Region, spikes: Mapping[str, Tensor], outputs: Sequence[str]) -> None:
    """Raise RuntimeError unless the network gives the region's spikes on some windows from rest."""
    few = {port: windows[:, ::20].float() for port, windows in spikes.items()}
    with torch.no_grad():
        ours = run(network, [windows[:, ::20].float() for windows in network.windows])[-1]
        batch = ours.shape[1]
        theirs, _ = region.step(few, region.init_state(batch))
    if not torch.equal(ours, torch.cat([theirs[port] for port in outputs], dim=-1)):
        raise RuntimeError(f"the network {network.name} no longer has the structure of its region")
