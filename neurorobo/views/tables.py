"""Summaries as tables for the terminal."""

from collections.abc import Mapping, Sequence
from typing import Any

from rich.table import Table
from rich.text import Text

MARK = " ± "


def summary_table(title: str, summary: Mapping[str, Any]) -> Table:
    """Return one row per figure: mean, standard error and worst over the episodes."""
    several = len(summary["episodes"]) > 1
    table = Table(title=f"{title}, {_episodes(summary)}", title_justify="left")
    table.add_column("figure")
    table.add_column("mean" if several else "value", justify="right")
    if several:
        table.add_column("worst", justify="right")
    for name, figure in summary["aggregate"].items():
        cells = [_mean(figure)] + ([_number(figure["worst"])] if several else [])
        table.add_row(name, *cells)
    return table


def comparison_table(summaries: Mapping[str, Mapping[str, Any]]) -> Table:
    """Return, below each figure, a row for every experiment that has it: as wide for two experiments as for ten."""
    table = Table(title="mean ± standard error, and the worst episode", title_justify="left")
    table.add_column("figure", overflow="fold")
    table.add_column("mean", justify="right")
    table.add_column("worst", justify="right")
    table.add_row("episodes", style="bold")
    for name, summary in summaries.items():
        table.add_row(Text(f"  {name}"), str(len(summary["episodes"])))
    for figure in _figures(list(summaries.values())):
        table.add_row(figure, style="bold")
        for name, summary in summaries.items():
            if (value := summary["aggregate"].get(figure)) is not None:
                table.add_row(Text(f"  {name}"), _mean(value), _number(value["worst"]))
    return table


def size_table(title: str, found: Mapping[str, Any]) -> Table:
    """Return what each region takes, of what :func:`neurorobo.experiment.measure.measure_experiment` returns."""
    table = Table(title=title, title_justify="left")
    table.add_column("region", no_wrap=True)
    for heading in ("parameters", "footprint, bytes", "stored, bytes", "connection sparsity"):
        table.add_column(heading, justify="right")
    for name, region in [*found["regions"].items(), ("total", found["total"])]:
        counts = (region["parameter_count"], region["footprint"], region["stored"])
        table.add_row(Text(name), *map(_count, counts), _share(region["connection_sparsity"]))
    return table


def work_table(found: Mapping[str, Any]) -> Table:
    """Return what each region and each of its uses does in a control period, on average."""
    periods, seeds = found["control_periods"], found["seeds"]
    title = f"per control period, of {periods:g} in {len(seeds)} episode{'s' if len(seeds) != 1 else ''}"
    table = Table(title=title, title_justify="left")
    table.add_column("region, use", no_wrap=True)
    for heading in ("windows", "activation sparsity", "effective ACs", "effective MACs", "dense"):
        table.add_column(heading, justify="right")

    def add(name: str, work: Mapping[str, Any]) -> None:
        counts = [work[count] if work["dense"] else None for count in ("effective_acs", "effective_macs", "dense")]
        table.add_row(Text(name), f"{work['windows']:.4g}", _share(work["activation_sparsity"]), *map(_count, counts))

    for name, region in found["regions"].items():
        add(name, region)
        for use, work in region["uses"].items():
            add(f"  {use}", work)
    add("total", found["total"])
    return table


def _figures(summaries: Sequence[Mapping[str, Any]]) -> list[str]:
    return list(dict.fromkeys(name for summary in summaries for name in summary["aggregate"]))


def _episodes(summary: Mapping[str, Any]) -> str:
    count = len(summary["episodes"])
    return f"{count} episode{'s' if count != 1 else ''}"


def _mean(figure: Mapping[str, Any]) -> str:
    error = figure["standard_error"]
    return _number(figure["mean"]) + ("" if error is None else f"{MARK}{_number(error, 2)}")


def _count(value: float | None) -> str:
    if value is None:
        return "-"
    scale, prefix = next((pair for pair in ((1e9, " G"), (1e6, " M"), (1e3, " k")) if value >= pair[0]), (1, ""))
    return f"{value / scale:.4g}{prefix}"


def _share(value: float | None) -> str:
    return "-" if value is None else f"{value:.4f}"


def _number(value: float, digits: int = 4) -> str:
    return f"{value:.{digits}g}" if abs(value) < 10 ** (digits - 1) else f"{value:.0f}"
