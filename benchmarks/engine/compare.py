"""The engine beside its peers, all taken in turn in one process.

Run ``python benchmarks/engine/compare.py`` on an otherwise idle machine (half an hour; ``--quick`` only tries whether
it works). It writes ``latest.json`` and ``speed.svg`` beside itself, the README's table, and a copy of the figures by
version into ``benchmarks/history``; it exits with 1 if a wanted ratio is missed, and says which. Peers are compared if
they are installed, as CONTRIBUTING.md says; without them, nothing is published. Stopped at any time, ``--resume`` goes
on.

Each network runs with random weights and spikes, and as it is shipped, on the spikes of recorded insertions: single
windows from rest, 256 at once, and training steps with Adam. Each implementation's output spikes are compared with
those of the plain equations first. Two floors are measured as well: the dense matrix products of the network alone, and
reading its weights once.
"""

import argparse
import hashlib
import itertools
import json
import os
import sys
from collections.abc import Callable, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import torch
from implementations import IMPLEMENTATIONS, Implementation
from networks import STEPS, Network, random_networks, run
from report import DENSE, READING, block, figure, into_readme, misses
from shipped import shipped_networks
from timing import LEAST_ROUNDS, Contestant, contest, peak_MB
from torch import Tensor

import neurorobo
from neurorobo.engine import engine_path, native
from neurorobo.synapses.product import linear

sys.path.append(str(Path(__file__).resolve().parents[1]))
from machine import machine

ROOT = Path(__file__).resolve().parents[2]
LATEST = Path(__file__).with_name("latest.json")
UNFINISHED = ROOT / "runs" / "engine" / "unfinished.json"
HISTORY = ROOT / "benchmarks" / "history"
GROUP = ("network", "inputs", "workload", "threads")
"""What is the same in rows that were taken in turn."""

SINGLE_WINDOWS = 8
"""How many windows one after the other are timed as one, where the batch is 1."""

EPISODES = 12
"""How many insertions are recorded, for 256 windows of each region."""


def installed() -> list[str]:
    """Return the implementations that are there, and tell of those that are not."""
    found = []
    for name, implementation in IMPLEMENTATIONS.items():
        try:
            version(implementation.library)
        except PackageNotFoundError:
            print(f"{name} is left out: it is not installed (CONTRIBUTING.md says how)")
            continue
        if implementation.is_native and engine_path().name != "native":
            print(f"{name} is left out: {engine_path().reason}")
            continue
        found.append(name)
    return found


def measure(
    network: Network, workload: str, batch: int, threads: int, names: Sequence[str], rounds: int
) -> list[dict[str, Any]]:
    """Return a row for each implementation and each floor; a single window is the mean of some, one after the other."""
    about = f"{network.name} {network.inputs}, {workload}, {threads} thread{'s' if threads > 1 else ''}"
    print(f"{about} ...", flush=True)
    torch.set_num_threads(threads)
    if any(IMPLEMENTATIONS[name].compiled for name in names):
        torch._dynamo.reset()
    generator = torch.Generator().manual_seed(1)
    windows = [network.draw(batch, generator) for _ in range(SINGLE_WINDOWS if workload == "b1" else 1)]
    with torch.inference_mode():
        spikes = [run(network, inputs) for inputs in windows]
    expected = [fired[-1] for fired in spikes]
    common = {
        "network": network.name,
        "inputs": network.inputs,
        "workload": workload,
        "batch": batch,
        "threads": threads,
        "firing_rate": {
            "input": _rate([x for inputs in windows for x in inputs]),
            "hidden": _rate([x for fired in spikes for x in fired[:-1]]),
            "output": _rate(expected),
        },
        "output_spikes": int(sum(fired.sum() for fired in expected)),
    }
    contestants, facts = [], []
    for name in (name for name in names if workload in IMPLEMENTATIONS[name].workloads):
        module = IMPLEMENTATIONS[name](network).train(workload == "train")
        with module.around(), torch.inference_mode(workload != "train"):
            differing = sum(int((module(x) != y).sum()) for x, y in zip(windows, expected, strict=True))
        memory_MB = None
        if workload == "train":
            once = _training(module, windows[0])
            if not module.compiled:  # the compiler would take more than what it compiles
                with module.around():
                    once()
                    memory_MB = _training_MB(IMPLEMENTATIONS[name](network), windows[0])
        else:
            once = _inference(module, windows)
        contestants.append(Contestant(name, once, len(windows), module.around))
        facts.append({"version": _version(module.library), "differing_spikes": differing, "memory_MB": memory_MB})
    products = _products(network, STEPS * batch, training=workload == "train")
    for name, floor in ((DENSE, products), (READING, _reading(network))):
        contestants.append(Contestant(name, floor))
        facts.append({"version": torch.__version__, "differing_spikes": None, "memory_MB": None})
    contest(contestants, rounds)
    rows = []
    for contestant, fact in zip(contestants, facts, strict=True):
        times = contestant.times()
        rows.append({"implementation": contestant.name, **common, **times, **fact})
        print(
            f"{about}: {contestant.name:30} {times['median_ms']:9.4g} ms "
            f"({times['min_ms']:.4g} to {times['max_ms']:.4g})",
            flush=True,
        )
    return rows


def _inference(module: Implementation, windows: Sequence[Sequence[Tensor]]) -> Callable[[], None]:
    """Return what runs all windows."""

    @torch.inference_mode()
    def once() -> None:
        for inputs in windows:
            module(inputs)

    return once


def _training(module: Implementation, inputs: Sequence[Tensor]) -> Callable[[], None]:
    """Return what takes a training step towards some output rates."""
    optimiser = torch.optim.Adam((p for p in module.parameters() if p.requires_grad), lr=1e-6, fused=True)

    def once() -> None:
        optimiser.zero_grad()
        (module(inputs).mean(0) - 0.1).square().mean().backward()
        optimiser.step()

    return once


def _training_MB(module: Implementation, inputs: Sequence[Tensor]) -> float | None:
    """Return the peak memory of the first two training steps above the built module, in MB.

    That is of activations, gradients, Adam's moments and whatever the library keeps. What torch and the library set up
    once is not, if another module has trained before.
    """
    once = _training(module, inputs)
    peak = peak_MB(lambda: (once(), once()))
    return None if peak is None else round(peak, 1)


def _products(network: Network, rows: int, *, training: bool) -> Callable[[], None]:
    """Return what computes a network's matrix products of so many rows; a fan-in counts as so many sources.

    By whichever of torch's libraries is the faster one. A training step has two more of each: for the gradients of the
    weights, and of what is not an input.
    """
    products = []
    for population in network.populations:
        is_first = max(population.reads) < len(network.sizes)
        for weight, needs_gradient in ((population.weight, not is_first), (population.recurrent, True)):
            if weight is not None:
                spikes, currents = torch.ones(rows, weight.shape[1]), torch.ones(rows, len(weight))
                products.append((spikes, weight))
                if training:
                    products.append((currents.t(), spikes.t()))
                if training and needs_gradient:
                    products.append((currents, weight.t()))

    @torch.inference_mode()
    def once() -> None:
        for left, right in products:
            linear(left, right)

    return once


def _reading(network: Network) -> Callable[[], None]:
    """Return what reads all weights."""
    weights = torch.cat([weight.flatten() for weight in network.weights()])

    @torch.inference_mode()
    def once() -> None:
        weights.sum()

    return once


def _rate(spikes: Sequence[Tensor]) -> float:
    return round(float(sum(x.sum() for x in spikes)) / max(1, sum(x.numel() for x in spikes)), 4)


def _version(distribution: str) -> str:
    return neurorobo.__version__ if distribution == "neurorobo" else version(distribution)


def write(found: dict[str, Any], file: Path) -> None:
    """Write what was found, a row on each line; whole, whenever it is stopped."""
    head = json.dumps({key: value for key, value in found.items() if key != "rows"}, indent=1)
    rows = ",\n  ".join(json.dumps(row) for row in found["rows"])
    file.parent.mkdir(parents=True, exist_ok=True)
    draft = file.with_suffix(".tmp")
    draft.write_text(f'{head[:-2]},\n "rows": [\n  {rows}\n ]\n}}\n')
    os.replace(draft, file)


def is_complete(rows: Sequence[dict[str, Any]]) -> bool:
    """Return whether all was measured with all, often enough."""
    floors = itertools.product(("b1", "b256", "train"), (DENSE, READING))
    ours_and_peers = ((workload, name) for name, it in IMPLEMENTATIONS.items() for workload in it.workloads)
    wanted = itertools.product("HPC", ("random", "shipped"), (1, 2), (*ours_and_peers, *floors))
    found = {
        (row["network"], row["inputs"], row["threads"], (row["workload"], row["implementation"]))
        for row in rows
        if row["samples"] >= LEAST_ROUNDS
    }
    return found == {*wanted} and len(rows) == len(found)


def publish(found: dict[str, Any]) -> None:
    """Write the figures, those of this version in the history, the picture, and the README's table."""
    for file in (LATEST, HISTORY / f"engine-{found['engine']['version']}.json"):
        write(found, file)
    LATEST.with_name("speed.svg").write_text(figure(found["rows"]))
    readme = ROOT / "README.md"
    readme.write_text(into_readme(readme.read_text(), found))


def engine() -> dict[str, str]:
    """Return what tells one engine from another: its version, and a hash of all its source."""
    folder = ROOT / "neurorobo" / "engine"
    sources = [folder / name for name in native.SOURCES]
    files = sorted([*folder.glob("*.py"), *sources, ROOT / "neurorobo" / "synapses" / "product.py"])
    source = hashlib.sha256(b"\0".join(file.read_bytes() for file in files)).hexdigest()
    return {"version": neurorobo.__version__, "source": source[:16]}


def resumed(fresh: dict[str, Any]) -> dict[str, Any]:
    """Return the figures so far; a SystemExit if there are none, or if they are of another engine or machine."""
    if not UNFINISHED.exists():
        raise SystemExit("there is nothing to resume; measure without --resume")
    found: dict[str, Any] = json.loads(UNFINISHED.read_text())
    passing = ("date", "load")
    known, now = ({**it["machine"], **it["engine"], **dict.fromkeys(passing)} for it in (found, fresh))
    if known != now:
        raise SystemExit(f"{UNFINISHED.name} is of another engine or machine; measure without --resume")
    return found


def main() -> int:
    """Measure, publish and print; return 1 if a wanted ratio is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="small networks and batches; publishes nothing")
    parser.add_argument("--resume", action="store_true", help="go on where a run was stopped")
    parser.add_argument("--rounds", type=int, default=9, help="samples of each; fewer than 5 are not published")
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2], help="fewer than both are not published")
    arguments = parser.parse_args()
    found: dict[str, Any] = {"engine": engine(), "machine": machine(), "rows": []}
    if (load := found["machine"]["load"]) > 0.5:
        print(f"warning: this machine is busy (load {load:g}); what is measured now means little")
    if arguments.resume:
        found = resumed(found)
    rounds, threads, names = arguments.rounds, arguments.threads, installed()
    unfinished = UNFINISHED.with_name("quick.json") if arguments.quick else UNFINISHED
    batches = {"b1": 1, "b256": 256, "train": 0}
    try:
        if arguments.quick:
            rounds, threads, batches = 1, [1], {"b1": 1, "train": 2}
            networks = [*random_networks(0.2), *shipped_networks(episodes=1)]
            names = [name for name in names if not IMPLEMENTATIONS[name].compiled]
        else:
            networks = [*random_networks(), *shipped_networks(EPISODES)]
        done = {tuple(row[key] for key in GROUP) for row in found["rows"]}
        for network in networks:
            for group in itertools.product([network.name], [network.inputs], batches, threads):
                if group not in done:
                    batch = batches[group[2]] or network.training_batch
                    found["rows"] += measure(network, group[2], batch, group[3], names, rounds)
                    write(found, unfinished)
    except KeyboardInterrupt:
        print("stopped; --resume goes on")
        return 130
    print(block(found))
    missed = [] if arguments.quick else misses(found["rows"])
    for miss in missed:
        print(f"MISSED by {miss}")
    if is_complete(found["rows"]):
        publish(found)
    else:
        print(f"nothing is published, as not all was measured; the figures are in {unfinished}")
    return int(bool(missed))


if __name__ == "__main__":
    sys.exit(main())
