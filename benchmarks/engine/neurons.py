"""What a window of each of the core's neurons takes on the native path, and by their own steps under autograd.

``python benchmarks/engine/neurons.py`` prints a table: a layer of 500 neurons that read 500 sources of 0.3 spikes a
step, windows of 50 steps, one thread, medians of samples taken in turn.
"""

import argparse
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import torch
from rich.console import Console
from rich.table import Table
from torch import Tensor

sys.path += [str(Path(__file__).parents[1]), str(Path(__file__).parent)]
from machine import machine
from timing import Contestant, contest

from neurorobo.engine import Layer, run_steps
from neurorobo.neurons import LIF, Neuron
from neurorobo.neurons.bidimensional import AdEx, Izhikevich
from neurorobo.neurons.generalized_lif import GeneralizedLIF
from neurorobo.neurons.soft_unit import SoftUnit
from neurorobo.synapses import Dense

STEPS, SOURCES, NEURONS, RATE = 50, 500, 500, 0.3
MODELS: dict[str, tuple[Neuron, float]] = {
    "lif": (LIF(), 0.6),
    "integrate_and_fire": (GeneralizedLIF(decay=1.0, reset="subtract"), 0.4),
    "exact_lif": (GeneralizedLIF(decay=0.95, input_gain=0.05), 15.0),
    "synaptic_lif": (GeneralizedLIF(decay=0.95, input_gain=0.05, synapse_decay=0.8), 5.0),
    "adaptive_lif": (GeneralizedLIF(decay=0.95, input_gain=0.05, adaptation=0.2, adaptation_decay=0.99), 15.0),
    "izhikevich": (Izhikevich(), 15.0),
    "adex": (AdEx(), 1500.0),
    "soft unit": (SoftUnit(), 0.6),
}


@contextmanager
def training(layer: Layer) -> Iterator[None]:
    """Keep gradients, and forget them."""
    with torch.enable_grad():
        yield
    layer.zero_grad()


def contestants(name: str, neuron: Neuron, gain: float) -> list[Contestant]:
    """Return inference of one and training of 64, each on the native path and step by step."""
    generator = torch.Generator().manual_seed(0)
    layer = Layer([Dense(SOURCES, NEURONS, generator, gain=gain)], neuron)

    def native(given: Tensor) -> Tensor:
        fired: Tensor = layer([given])[0]
        return fired

    def stepped(given: Tensor) -> Tensor:
        return run_steps(layer.projections[0](given), layer.at_rest(given.shape[1]), neuron)[0]

    found = []
    for batch in (1, 64):
        given = (torch.rand(STEPS, batch, SOURCES, generator=generator) < RATE).float()
        for way, run in (("native", native), ("stepped", stepped)):
            found.append(_contestant(f"{name} {way} {batch}", layer, run, given, trains=batch > 1))
    return found


def _contestant(name: str, layer: Layer, run: Callable[[Tensor], Tensor], given: Tensor, *, trains: bool) -> Contestant:
    def train() -> None:
        run(given).sum().backward()

    def infer() -> None:
        run(given)

    return Contestant(name, train if trains else infer, around=lambda: training(layer) if trains else torch.no_grad())


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=7, help="samples of each")
    rounds = parser.parse_args().rounds
    torch.set_num_threads(1)
    table = Table("neuron", "batch 1 / ms", "by steps", "training, batch 64 / ms", "by steps")
    for name, (neuron, gain) in MODELS.items():
        each = contestants(name, neuron, gain)
        contest(each, rounds)
        table.add_row(name, *(f"{contestant.times()['median_ms']:.3g}" for contestant in each))
    console = Console()
    console.print(table)
    console.print(", ".join(f"{key} {value}" for key, value in machine().items()))


if __name__ == "__main__":
    main()
