"""How the time of one window of a layer grows with each of its sizes, the others fixed, on both paths of the engine.

Run ``python benchmarks/engine/sweeps.py`` on an otherwise idle machine (minutes; ``--quick`` only tries whether it
works). It writes ``sweeps.json`` and ``sweeps.svg`` beside itself and the slopes into the README: those of the
logarithm of the time over that of the size, fitted to all sizes and to the larger half, where fixed costs matter less.
"""

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from chart import COLOURS, Axis, dot, grid, legend, line, svg, text
from implementations import Implementation, Native, Portable
from networks import Network, Population
from timing import Contestant, contest

from neurorobo.engine import engine_path

sys.path.append(str(Path(__file__).resolve().parents[1]))
from machine import machine
from page import between

ROOT = Path(__file__).resolve().parents[2]
LATEST = Path(__file__).with_name("sweeps.json")
START, END = "<!-- slopes: python benchmarks/engine/sweeps.py -->", "<!-- end of slopes -->"


@dataclass(frozen=True)
class Sizes:
    """A layer with dense synapses from all sources, and its input; the rate is of spikes per source and step."""

    neurons: int = 512
    synapses: int = 512
    rate: float = 0.2
    batch: int = 1
    steps: int = 50


SWEEPS: Mapping[str, Sequence[Any]] = {
    "neurons": [64 * 2**k for k in range(7)],
    "synapses": [64 * 2**k for k in range(7)],
    "rate": [0.01 * 2**k for k in range(7)],
    "batch": [2**k for k in range(9)],
    "steps": [10 * 2**k for k in range(7)],
}
NAMES = {
    "neurons": "neurons",
    "synapses": "synapses per neuron",
    "rate": "firing rate of the sources",
    "batch": "windows at once",
    "steps": "steps of a window",
}
PATHS: Mapping[str, type[Implementation]] = {"native": Native, "portable": Portable}


def contestant(path: str, sizes: Sizes) -> Contestant:
    """Return one path with a window of such sizes."""
    generator = torch.Generator().manual_seed(0)
    weight = torch.randn(sizes.neurons, sizes.synapses, generator=generator) / (sizes.synapses * sizes.rate) ** 0.5
    network = Network("layer", "random", (sizes.synapses,), (Population((0,), weight),), sizes.batch)
    module = PATHS[path](network)
    spikes = (torch.rand(sizes.steps, sizes.batch, sizes.synapses, generator=generator) < sizes.rate).float()

    @torch.inference_mode()
    def once() -> None:
        module([spikes])

    return Contestant(path, once, around=module.around)


def sweep(name: str, numbers: Sequence[Any], paths: Sequence[str], rounds: int) -> dict[str, Any]:
    """Return the times over one size, by path, and their slopes."""
    times: dict[str, list[dict[str, float]]] = {path: [] for path in paths}
    for number in numbers:
        contestants = [contestant(path, replace(Sizes(), **{name: number})) for path in paths]
        contest(contestants, rounds)
        for one in contestants:
            times[one.name].append(one.times())
        print(f"{name} {number:g}: " + ", ".join(f"{one.name} {one.times()['median_ms']:g} ms" for one in contestants))
    half = len(numbers) // 2
    return {
        "size": name,
        "numbers": list(numbers),
        "paths": {
            path: {
                "times": found,
                "slope": slope(numbers, [time["median_ms"] for time in found]),
                "slope_of_larger_half": slope(numbers[half:], [time["median_ms"] for time in found[half:]]),
            }
            for path, found in times.items()
        },
    }


def slope(numbers: Sequence[float], times_ms: Sequence[float]) -> float:
    """Return the slope of the logarithm of the times over that of the numbers: 1 if they are in proportion."""
    return round(float(np.polyfit(np.log(numbers), np.log(times_ms), 1)[0]), 3)


def into_readme(text: str, found: Mapping[str, Any]) -> str:
    """Return the README with its slopes replaced."""
    sweeps, machine = found["sweeps"], found["machine"]
    lines = [
        f"| path | {' | '.join(NAMES[one['size']] for one in sweeps)} |",
        f"| {' | '.join(['---'] * (1 + len(sweeps)))} |",
    ]
    for path in sweeps[0]["paths"]:
        slopes = [one["paths"][path] for one in sweeps]
        cells = [f"{it['slope']:.2f} ({it['slope_of_larger_half']:.2f})" for it in slopes]
        lines.append(f"| {path} | {' | '.join(cells)} |")
    fixed = ", ".join(f"{found['fixed'][one['size']]:g} {NAMES[one['size']]}" for one in sweeps)
    about = (
        f"Fitted to all sizes, in brackets to the larger half; the other sizes are fixed ({fixed}). One thread, "
        f"{machine['processor']}, {machine['date']}: [the times](benchmarks/engine/sweeps.svg)."
    )
    return between(text, START, END, "\n".join(lines) + f"\n\n{about}")


def figure(sweeps: Sequence[Mapping[str, Any]]) -> str:
    """Return the picture: a panel for each size, with the slopes of the larger half."""
    paths = list(sweeps[0]["paths"])
    parts = legend(60, 20, paths)
    width, height, top, left = 260.0, 220.0, 70.0, 60.0
    times = [ms for one in sweeps for found in one["paths"].values() for time in found["times"] for ms in time.values()]
    y = Axis.around(times, top + height, top)
    for number, one in enumerate(sweeps):
        start = left + (width + 50) * number
        x = Axis.around(one["numbers"], start, start + width)
        parts += grid(x, y, top, top + height)
        parts.append(text(start, top - 12, f"ms over {NAMES[one['size']]}"))
        for place, (colour, path) in enumerate(zip(COLOURS, paths, strict=False)):
            found = one["paths"][path]
            places = [
                (x.at(n), y.at(time["median_ms"])) for n, time in zip(one["numbers"], found["times"], strict=True)
            ]
            parts.append(line(places, colour, 1.5))
            for (across, up), n, time in zip(places, one["numbers"], found["times"], strict=True):
                ends = [(across, y.at(time[key])) for key in ("min_ms", "max_ms")]
                parts += [line(ends, colour, 2), dot(across, up, colour, f"{n:g}: {time['median_ms']} ms")]
            parts.append(
                text(start + 8, top + 16 + 16 * place, f"slope {found['slope_of_larger_half']:.2f}", colour=colour)
            )
    return svg(left + (width + 50) * len(sweeps), top + height + 30, parts)


def main() -> int:
    """Measure, write and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="three sizes each; writes nothing")
    parser.add_argument("--rounds", type=int, default=9, help="samples of each")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    paths = [path for path in PATHS if path != "native" or engine_path().name == "native"]
    if "native" not in paths:
        print(f"native is left out: {engine_path().reason}")
    chosen = {name: numbers[:3] if arguments.quick else numbers for name, numbers in SWEEPS.items()}
    rounds = 1 if arguments.quick else arguments.rounds
    sweeps = [sweep(name, numbers, paths, rounds) for name, numbers in chosen.items()]
    for one in sweeps:
        slopes = [f"{path} {it['slope']} ({it['slope_of_larger_half']})" for path, it in one["paths"].items()]
        print(f"slope over {NAMES[one['size']]}, of all sizes (the larger half): {', '.join(slopes)}")
    if arguments.quick:
        return 0
    fixed = {name: getattr(Sizes(), name) for name in SWEEPS}
    found = {"machine": machine(), "threads": 1, "fixed": fixed, "sweeps": sweeps}
    LATEST.write_text(json.dumps(found, indent=1) + "\n")
    LATEST.with_suffix(".svg").write_text(figure(sweeps))
    readme = ROOT / "README.md"
    readme.write_text(into_readme(readme.read_text(), found))
    return 0


if __name__ == "__main__":
    sys.exit(main())
