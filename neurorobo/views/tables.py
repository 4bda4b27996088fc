"""Summaries as tables for the terminal."""

from collections.abc import Mapping, Sequence
from typing import Any

from rich.table import Table

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
    """Return one column per experiment and one row per figure; a figure that an experiment lacks is left empty."""
    table = Table(title="mean ± standard error (worst)", title_justify="left")
    table.add_column("figure")
    for name, summary in summaries.items():
        table.add_column(f"{name}\n{_episodes(summary)}", justify="right")
    for figure in _figures(list(summaries.values())):
        cells = []
        for summary in summaries.values():
            value = summary["aggregate"].get(figure)
            cells.append("" if value is None else f"{_mean(value)} ({_number(value['worst'])})")
        table.add_row(figure, *cells)
    return table


def _figures(summaries: Sequence[Mapping[str, Any]]) -> list[str]:
    return list(dict.fromkeys(name for summary in summaries for name in summary["aggregate"]))


def _episodes(summary: Mapping[str, Any]) -> str:
    count = len(summary["episodes"])
    return f"{count} episode{'s' if count != 1 else ''}"


def _mean(figure: Mapping[str, Any]) -> str:
    error = figure["standard_error"]
    return _number(figure["mean"]) + ("" if error is None else f"{MARK}{_number(error)}")


def _number(value: float) -> str:
    return f"{value:.4g}" if abs(value) < 1000 else f"{value:.0f}"
