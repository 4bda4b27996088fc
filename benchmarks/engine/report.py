"""What the comparison comes to: the README's table and figure, and which of the wanted ratios are missed."""

import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from chart import COLOURS, GREY, Axis, dot, grid, legend, line, svg, text

sys.path.append(str(Path(__file__).resolve().parents[1]))
from page import between

START, END = "<!-- speed: python benchmarks/engine/compare.py -->", "<!-- end of speed -->"
DENSE, READING = "floor, dense product", "floor, weights read once"
NATIVE, PORTABLE = "neurorobo, native", "neurorobo, portable"
VARIANTS = {variant: f"{NATIVE}, {variant}" for variant in ("bf16", "floats")}
LOOP, LAYERED = "snnTorch, stepwise", "snnTorch"
COLUMNS = {
    "native": (NATIVE,),
    "native, bf16": (VARIANTS["bf16"],),
    "portable": (PORTABLE,),
    "snnTorch": (LAYERED, LOOP),
    "snnTorch compiled": ("snnTorch, compiled", "snnTorch, stepwise, compiled"),
    "SpikingJelly": ("SpikingJelly",),
    "Norse": ("Norse",),
    "Sinabs": ("Sinabs",),
}
"""Of each column of the figure the implementations, of which it shows the fastest."""

WORKLOADS = {"b1": "1 window", "b256": "256 windows", "train": "training"}

WANTED: Mapping[tuple[str, str], Mapping[str, float]] = {
    (NATIVE, "b1"): {"H": 150, "P": 140, "C": 38},
    (NATIVE, "b256"): {"H": 4, "P": 6, "C": 5},
    (NATIVE, "train"): {"H": 3.3, "P": 3.4, "C": 4.7},
    (PORTABLE, "b1"): {"H": 7, "P": 10, "C": 7},
    (PORTABLE, "b256"): {"H": 1.3, "P": 1.5, "C": 1.4},
    (PORTABLE, "train"): {"H": 1.7, "P": 1.6, "C": 3},
}
"""How many times as fast as snnTorch's loop over the steps, of Linear and Leaky, on one thread."""

WANTED_OF_PEERS = {"b1": 3.0, "b256": 3.0, "train": 1.5}
"""How many times as fast as the fastest peer the native path is wanted to be, on any number of threads."""

EXPLANATION = """\
H, P and C are the networks of hippocampus, prefrontal cortex and cerebellum: with random weights and spikes, or as they
are shipped, on the spikes of recorded insertions. Firing rates are those of inputs, hidden neurons and outputs. A
window has 50 steps; training is one step with Adam, and *bf16* lets matrix products round their factors where the
processor gains by it. Weights lie on a grid, which lets the native path pack them in 8 or 16 bits; *floats* are the
same weights without. *snnTorch* is its loop over the steps / the same layer by layer; *fastest peer* is of all,
compiled ones included. The ratios are to these three; in brackets what is wanted."""

Row = Mapping[str, Any]


@dataclass(frozen=True)
class Group:
    """The rows that were taken in turn, by implementation."""

    network: str
    inputs: str
    workload: str
    threads: int
    rows: Mapping[str, Row]

    def ms(self, name: str) -> float | None:
        """Return the median of an implementation, if it was measured."""
        return self.rows[name]["median_ms"] if name in self.rows else None

    def fastest(self, names: Sequence[str]) -> Row | None:
        """Return the row of the fastest of some implementations."""
        return min((self.rows[name] for name in names if name in self.rows), key=_median, default=None)

    def fastest_peer(self) -> Row | None:
        """Return the row of the fastest that is neither ours nor a floor."""
        return self.fastest([name for name in self.rows if not name.startswith(("floor", "neurorobo"))])

    def ratios(self, ours: str) -> list[float | None]:
        """Return how many times as fast as snnTorch's loop, as its layers, and as the fastest peer one of ours is."""
        peer, own = self.fastest_peer(), self.ms(ours)
        others = [self.ms(LOOP), self.ms(LAYERED), None if peer is None else _median(peer)]
        return [None if own is None or other is None else other / own for other in others]

    def wanted(self, ours: str) -> float | None:
        """Return the wanted ratio to snnTorch's loop, if there is one."""
        return WANTED.get((ours, self.workload), {}).get(self.network) if self.threads == 1 else None


def groups(rows: Sequence[Row]) -> list[Group]:
    """Return the rows by what they have in common, in their order."""
    found: dict[tuple[str, str, str, int], dict[str, Row]] = {}
    for row in rows:
        key = (row["network"], row["inputs"], row["workload"], row["threads"])
        found.setdefault(key, {})[row["implementation"]] = row
    return [Group(*key, some) for key, some in found.items()]


def misses(rows: Sequence[Row]) -> list[str]:
    """Return in words what is missed of what is wanted."""
    return [
        f"{one.network} {one.inputs}, {one.workload}, {one.threads} thread{'s' if one.threads > 1 else ''}: {miss}"
        for one in groups(rows)
        for miss in _misses(one)
    ]


def _misses(group: Group) -> Iterator[str]:
    for ours in (NATIVE, PORTABLE):
        to_loop, _, to_peer = group.ratios(ours)
        wanted = group.wanted(ours)
        if to_loop is not None and wanted is not None and to_loop < wanted:
            yield f"{ours} is {to_loop:.4g} times as fast as {LOOP}, wanted {wanted:g}"
        if ours == NATIVE and to_peer is not None and to_peer < (wanted := WANTED_OF_PEERS[group.workload]):
            yield f"{ours} is {to_peer:.4g} times as fast as {_peer_name(group)}, wanted {wanted:g}"
    snntorch = [row["memory_MB"] for name in (LOOP, LAYERED) if (row := group.rows.get(name)) and row["memory_MB"]]
    for ours in (NATIVE, PORTABLE, *VARIANTS.values()):
        row = group.rows.get(ours, {})
        if snntorch and (row.get("memory_MB") or 0) >= min(snntorch):
            yield f"{ours} takes {row['memory_MB']:g} MB, wanted less than snnTorch's {min(snntorch):g}"
        if row.get("differing_spikes"):
            yield f"{row['differing_spikes']} of the output spikes of {ours} differ from those of the equations"


def block(found: Mapping[str, Any]) -> str:
    """Return what stands in the README between the markers."""
    rows: Sequence[Row] = found["rows"]
    machine, engine = found["machine"], found["engine"]
    versions = {
        name.split(",")[0]: row["version"] for one in groups(rows) for name, row in one.rows.items() if _is_peer(name)
    }
    measured = (
        f"Median milliseconds on one thread of {machine['cores']} ({machine['processor']}, "
        f"{machine['instructions'] or 'no native path'}), {machine['date']}, neurorobo {engine['version']} "
        f"(engine {engine['source']}), "
        + ", ".join(f"{name} {version}" for name, version in {"PyTorch": machine["torch"], **versions}.items())
        + f". {_differences(rows)}"
    )
    single = [one for one in groups(rows) if one.threads == 1]
    parts = [_table(single), measured, EXPLANATION, _memory(single), "![The times](benchmarks/engine/speed.svg)"]
    return "\n\n".join(part for part in parts if part)


def into_readme(text: str, found: Mapping[str, Any]) -> str:
    """Return the README with what stands between the markers replaced."""
    return between(text, START, END, block(found))


def _table(single: Sequence[Group]) -> str:
    heads = ("network", "weights", "firing rates", "workload", "native", "portable", "snnTorch", "fastest peer")
    lines = [
        f"| {' | '.join(heads)} | native, times as fast | portable, times as fast |",
        f"| {' | '.join(['---'] * 10)} |",
    ]
    for one in single:
        first = next(iter(one.rows.values()))
        workload = WORKLOADS[one.workload] + (f", batch {first['batch']}" if one.workload == "train" else "")
        native = [_short(one.ms(NATIVE))]
        native += [f"{variant} {_short(ms)}" for variant, name in VARIANTS.items() if (ms := one.ms(name)) is not None]
        peer = one.fastest_peer()
        cells = [
            one.network,
            one.inputs,
            ", ".join(f"{first['firing_rate'][where]:.2f}" for where in ("input", "hidden", "output")),
            workload,
            ", ".join(native),
            _short(one.ms(PORTABLE)),
            f"{_short(one.ms(LOOP))} / {_short(one.ms(LAYERED))}",
            "-" if peer is None else f"{_short(_median(peer))} ({_peer_name(one)})",
            *(_ratio_cell(one, ours) for ours in (NATIVE, PORTABLE)),
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def _ratio_cell(group: Group, ours: str) -> str:
    loop, layered, peer = map(_short, group.ratios(ours))
    wanted = group.wanted(ours)
    return f"{loop}{'' if wanted is None else f' ({wanted:g})'} / {layered} / {peer}"


def _memory(single: Sequence[Group]) -> str:
    """Say what training steps take."""
    found = []
    for one in single:
        cells = [one.rows[name].get("memory_MB") for name in (NATIVE, PORTABLE, LOOP) if name in one.rows]
        if any(cells):
            found.append(f"{one.network} {one.inputs} {' / '.join(map(_short, cells))}")
    if not found:
        return ""
    return (
        "Peak memory of training above the built model in MB, native / portable / snnTorch's loop: "
        + ", ".join(found)
        + "."
    )


def _differences(rows: Sequence[Row]) -> str:
    """Say whose spikes are not those of the plain equations."""
    largest: dict[str, float] = {}
    for row in rows:
        if row["differing_spikes"]:
            name = row["implementation"]
            largest[name] = max(largest.get(name, 0.0), row["differing_spikes"] / max(1, row["output_spikes"]))
    if not largest:
        return "All give the same spikes."
    return (
        "Not all give the same spikes: "
        + ", ".join(f"up to {100 * share:.2g} % of those of {name} differ" for name, share in sorted(largest.items()))
        + "."
    )


def _median(row: Row) -> float:
    return float(row["median_ms"])


def _peer_name(group: Group) -> str:
    peer = group.fastest_peer()
    return "no peer" if peer is None else str(peer["implementation"])


def _is_peer(name: str) -> bool:
    return not name.startswith(("floor", "neurorobo"))


def _short(number: float | None) -> str:
    """Return a number with three digits, or all of those before the point; a dash for none."""
    if number is None:
        return "-"
    return f"{number:.0f}" if number >= 100 else f"{number:.3g}"


def figure(rows: Sequence[Row]) -> str:
    """Return the picture: a line for each network and workload, a panel for each number of threads."""
    known = groups(rows)
    counts = sorted({one.threads for one in known})
    names = list(dict.fromkeys((one.network, one.inputs, one.workload) for one in known))
    columns = [column for column, names_of in COLUMNS.items() if any(one.fastest(names_of) for one in known)]
    shown = [row for row in rows if row["implementation"] != READING]
    top, step, left, panel = 60.0, 22.0, 190.0, 380.0
    bottom = top + step * len(names)
    parts = legend(left, 20, columns)
    for number, threads in enumerate(counts):
        start = left + (panel + 60) * number
        x = Axis.around((row[key] for row in shown for key in ("min_ms", "max_ms")), start, start + panel)
        parts += grid(x, None, top, bottom)
        parts.append(text(start, top - 12, f"{threads} thread{'s' if threads > 1 else ''}, ms per window or step"))
        for one in (one for one in known if one.threads == threads):
            y = top + step * (names.index((one.network, one.inputs, one.workload)) + 0.5)
            if number == 0:
                parts.append(text(left - 10, y + 4, f"{one.network} {one.inputs}, {WORKLOADS[one.workload]}", "end"))
            if (floor := one.ms(DENSE)) is not None:
                parts.append(line([(x.at(floor), y - 9), (x.at(floor), y + 9)], GREY, 2))
            for colour, column in zip(COLOURS, columns, strict=False):
                if (row := one.fastest(COLUMNS[column])) is not None:
                    ends = [(x.at(row[key]), y) for key in ("min_ms", "max_ms")]
                    title = f"{row['implementation']} {row['version']}: {row['median_ms']} ms"
                    parts += [line(ends, colour, 2), dot(x.at(_median(row)), y, colour, title)]
    parts.append(text(left, bottom + 36, "dots: medians; lines: least to largest; upright: the dense product alone"))
    return svg(left + max((panel + 60) * len(counts), 120 * len(columns)), bottom + 46, parts)
