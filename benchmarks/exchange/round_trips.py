"""Do other libraries, and we ourselves, give the spikes of a network that went through a file of NIR?

    pip install --no-deps -r benchmarks/engine/peers.txt
    python benchmarks/exchange/round_trips.py

Each network is exported, read back from the file, and run on the same random spikes by every library that is installed;
the spikes of every layer are compared with ours. Exits with 1 if a library that can read a network gives other ones.
"""

import argparse
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import torch
from agreement import Agreement, agreement
from peers import PEERS
from samples import NETWORKS, circuit, run, spikes
from torch import Tensor

from neurorobo.config.experiment import load_experiment
from neurorobo.experiment.build import build_brain
from neurorobo.interchange import neurons
from neurorobo.interchange.export import export_region
from neurorobo.interchange.importing import import_network
from neurorobo.interchange.library import nir
from neurorobo.plugins import Registry
from neurorobo.regions.region import Region

EXAMPLE = Path(__file__).parents[2] / "examples" / "peg_in_hole.yaml"
SHIPPED = ("cerebellum", "prefrontal_cortex")
MISREAD = {
    "snnTorch's importer": ("recurrent", "recurrent, weights on a grid", "recurrent, with a skip"),
    "Norse's importer": ("recurrent, with a skip", *SHIPPED),
}
"""What the importers of peers fail at, or give other spikes for; their nodes, wired by nirtorch, do neither."""


def regions(seeds: int) -> Iterator[tuple[str, Region, int]]:
    """Yield each network by name, with the seed of its input spikes."""
    for name, build in NETWORKS.items():
        for seed in range(seeds):
            yield name, build(seed), seed
    brain = build_brain(load_experiment(EXAMPLE))
    for name in SHIPPED:
        for seed in range(seeds):
            yield name, brain.region(name), seed


def compared(region: Region, inputs: Tensor, file: Path, registry: Registry) -> Iterator[tuple[str, Agreement | str]]:
    """Yield for each library whether it agrees with us on a region, or why it cannot be told."""
    wiring = circuit(region)
    known, ours = run(region, inputs)
    export_region(region, file, registry)
    imported = import_network(file, registry).region
    yield "neurorobo", agreement(wiring, known, ours, run(imported, inputs)[1])
    for name, peer in PEERS.items():
        try:
            theirs = peer(nir().read(file), inputs)
        except ImportError as error:
            yield name, f"not installed ({error})"
            continue
        except Exception as error:  # of an importer, of whatever type
            yield name, f"fails ({type(error).__name__}: {error})"
            continue
        named = {layer.removesuffix(".lif"): trains for layer, trains in theirs.items() if len(trains) == len(inputs)}
        yield name, agreement(wiring, known, ours, named)


def main() -> None:
    """Compare all networks, libraries and seeds, and print a row for each network and library."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=6, help="Networks of each kind, and inputs of each region.")
    parser.add_argument(
        "--plain-thresholds", action="store_true", help="Write thresholds as they are, not lowered to let ties fire."
    )
    arguments = parser.parse_args()
    if arguments.plain_thresholds:
        neurons.TIE = 0.0
    torch.set_num_threads(1)
    registry = Registry.discover()
    found: dict[tuple[str, str], list[Agreement | str]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, region, seed in regions(arguments.seeds):
            shipped = name in SHIPPED
            inputs = spikes(region, steps=50 if shipped else 200, batch=4, seed=seed)
            for library, result in compared(region, inputs, Path(folder) / "network.nir", registry):
                found.setdefault((name, library), []).append(result)
    missed = False
    print("| network | library | seeds | neuron steps | different |\n| --- | --- | --- | --- | --- |")
    for (name, library), results in found.items():
        told = [result for result in results if isinstance(result, Agreement)]
        if not told:
            missed |= "fails" in str(results[0]) and name not in MISREAD.get(library, ())
            print(f"| {name} | {library} | | | {results[0]} |")
            continue
        total = replace(
            told[0],
            steps=sum(each.steps for each in told),
            different=sum(each.different for each in told),
            first_distances=tuple(distance for each in told for distance in each.first_distances),
        )
        verdict = "" if total.holds else "other spikes"
        if not total.holds and name not in MISREAD.get(library, ()):
            missed, verdict = True, "other spikes, MISSED"
        rounding = "" if not total.different or verdict else f"first within {max(total.first_distances):.0e}"
        print(f"| {name} | {library} | {len(told)} | {total.steps} | {total.different} {verdict}{rounding} |")
    sys.exit(missed)


if __name__ == "__main__":
    main()
