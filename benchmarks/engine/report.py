"""What the README shows of the comparison: its table, and its figure."""

from collections.abc import Mapping, Sequence
from typing import Any

from chart import COLOURS, GREY, Axis, dot, grid, legend, line, svg, text

START, END = "<!-- speed: python benchmarks/engine/compare.py -->", "<!-- end of speed -->"
DENSE, READING = "floor, dense product", "floor, weights read once"
COLUMNS = {
    "native": ("neurorobo, native",),
    "portable": ("neurorobo, portable",),
    "snnTorch": ("snnTorch", "snnTorch, stepwise"),
    "snnTorch compiled": ("snnTorch, compiled", "snnTorch, stepwise, compiled"),
    "SpikingJelly": ("SpikingJelly",),
    "Norse": ("Norse",),
    "Sinabs": ("Sinabs",),
    "dense product": (DENSE,),
    "weights read": (READING,),
}
"""Of each column the implementations, of which it shows the faster one."""
WORKLOADS = {"b1": "1 window", "b256": "256 windows", "train": "training"}

EXPLANATION = """\
H, P and C are the networks of hippocampus, prefrontal cortex and cerebellum: with random weights and spikes, or as they
are shipped, on the spikes of recorded insertions. A window has 50 steps; training is one step with Adam. *snnTorch* is
the faster of two ways to write it, layer by layer and step by step. The last two columns are floors: *dense product* is
the matrix products of the network and nothing else, *weights read* is reading each weight once."""

Row = Mapping[str, Any]


def block(found: Mapping[str, Any]) -> str:
    """Return what stands in the README between the markers."""
    rows: Sequence[Row] = found["rows"]
    machine = found["machine"]
    versions = {row["implementation"].split(",")[0]: row["version"] for row in rows if _is_peer(row)}
    counts = sorted({row["threads"] for row in rows})
    columns = [column for column in COLUMNS if _has(rows, column)]
    timed = [column for column in columns if not _is_floor(column)]
    paragraphs = [
        _table(rows, "median_ms", columns, counts),
        f"Milliseconds on {' / '.join(map(str, counts))} thread{'s' if counts[-1] > 1 else ''}: medians, on a machine "
        f"of {machine['cores']} cores ({machine['processor']}, {machine['instructions'] or 'no native path'}), "
        f"{machine['date']}, PyTorch {machine['torch']}, "
        + ", ".join(f"{name} {version}" for name, version in versions.items())
        + f". {_differences(rows)}",
        EXPLANATION,
        _table([row for row in rows if row["workload"] == "train"], "memory_MB", timed, counts[:1]),
        "Peak memory of the training step above the built model, in MB.",
        "![The times as dots](benchmarks/engine/speed.svg)",
    ]
    return "\n\n".join(paragraphs)


def into_readme(text: str, found: Mapping[str, Any]) -> str:
    """Return the README with what stands between the markers replaced; as it is if it has no markers."""
    if START not in text:
        return text
    before, rest = text.split(START)
    _, after = rest.split(END)
    return f"{before}{START}\n\n{block(found)}\n\n{END}{after}"


def _table(rows: Sequence[Row], figure: str, columns: Sequence[str], counts: Sequence[int]) -> str:
    lines = [
        f"| network | weights | firing rate: input, hidden, output | workload | {' | '.join(columns)} |",
        f"| {' | '.join(['---'] * (4 + len(columns)))} |",
    ]
    for (network, inputs, _), some in _groups(rows).items():
        rate = some[0]["firing_rate"]
        rates = ", ".join(f"{rate[where]:.2f}" for where in ("input", "hidden", "output"))
        cells = [_cell(some, figure, column, counts) for column in columns]
        lines.append(f"| {network} | {inputs} | {rates} | {_named(some[0])} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _cell(rows: Sequence[Row], figure: str, column: str, counts: Sequence[int]) -> str:
    best = [_best(rows, column, threads) for threads in counts]
    numbers = [None if row is None else row[figure] for row in best]
    return " / ".join("-" if number is None else _short(number) for number in numbers)


def _best(rows: Sequence[Row], column: str, threads: int) -> Row | None:
    some = [row for row in rows if row["implementation"] in COLUMNS[column] and row["threads"] == threads]
    return min(some, key=lambda row: float(row["median_ms"]), default=None)


def _groups(rows: Sequence[Row]) -> dict[tuple[str, str, str], list[Row]]:
    groups: dict[tuple[str, str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row["network"], row["inputs"], row["workload"]), []).append(row)
    return groups


def _has(rows: Sequence[Row], column: str) -> bool:
    return any(row["implementation"] in COLUMNS[column] for row in rows)


def _is_floor(column: str) -> bool:
    return COLUMNS[column][0].startswith("floor")


def _named(row: Row) -> str:
    """Return the workload in words."""
    words = WORKLOADS[row["workload"]]
    return f"{words}, batch {row['batch']}" if row["workload"] == "train" else words


def _is_peer(row: Row) -> bool:
    return not row["implementation"].startswith(("floor", "neurorobo"))


def _differences(rows: Sequence[Row]) -> str:
    """Say whose spikes are not those of the plain equations."""
    largest: dict[str, float] = {}
    for row in rows:
        if row["differing_spikes"]:
            name = row["implementation"]
            largest[name] = max(largest.get(name, 0.0), row["differing_spikes"] / row["output_spikes"])
    if not largest:
        return "All give the same spikes."
    return (
        "Not all give the same spikes: "
        + ", ".join(f"up to {100 * share:.2g} % of those of {name} differ" for name, share in sorted(largest.items()))
        + "."
    )


def _short(number: float) -> str:
    """Return a number with three digits, or all of those before the point."""
    return f"{number:.0f}" if number >= 100 else f"{number:.3g}"


def figure(rows: Sequence[Row]) -> str:
    """Return the picture: a line for each network and workload, a panel for each number of threads."""
    columns = [column for column in COLUMNS if _has(rows, column) and not _is_floor(column)]
    groups, counts = _groups(rows), sorted({row["threads"] for row in rows})
    shown = [row for row in rows if row["implementation"] != READING]
    top, step, left, panel = 60.0, 22.0, 190.0, 380.0
    bottom = top + step * len(groups)
    parts = legend(left, 20, columns)
    for number, threads in enumerate(counts):
        start = left + (panel + 60) * number
        x = Axis.around((row[key] for row in shown for key in ("min_ms", "max_ms")), start, start + panel)
        parts += grid(x, None, top, bottom)
        parts.append(text(start, top - 12, f"{threads} thread{'s' if threads > 1 else ''}, ms per window or step"))
        for place, ((network, inputs, _), some) in enumerate(groups.items()):
            y = top + step * (place + 0.5)
            if number == 0:
                parts.append(text(left - 10, y + 4, f"{network} {inputs}, {_named(some[0])}", "end"))
            floor = _best(some, "dense product", threads)
            if floor is not None:
                at = x.at(floor["median_ms"])
                parts.append(line([(at, y - 9), (at, y + 9)], GREY, 2))
            for colour, column in zip(COLOURS, columns, strict=False):
                row = _best(some, column, threads)
                if row is not None:
                    ends = [(x.at(row[key]), y) for key in ("min_ms", "max_ms")]
                    title = f"{row['implementation']} {row['version']}: {row['median_ms']} ms"
                    parts += [line(ends, colour, 2), dot(x.at(row["median_ms"]), y, colour, title)]
    parts.append(text(left, bottom + 36, "dots: medians; lines: least to largest; upright: the dense product alone"))
    return svg(left + max((panel + 60) * len(counts), 120 * len(columns)), bottom + 46, parts)
