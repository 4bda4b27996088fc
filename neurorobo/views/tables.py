"""Summaries as tables for the terminal."""

from collections.abc import Mapping, Sequence
from typing import Any

from rich.table import Table

MARK = " ± "


def summary_table(title: str, summary: Mapping[str, Any]) -> Table:
    """Return one row per figure: mean, standard error and worst over the episodes."""
    episodes = len(summary["episodes"])
    table = Table(title=f"{title}, {episodes} episode{'s' if episodes != 1 else ''}", title_justify="left")
    table.add_column("figure")
    table.add_column("mean" if episodes > 1 else "value", justify="right")
    if episodes > 1:
        table.add_column("worst", justify="right")
    for name, figure in summary["aggregate"].items():
        cells = [_mean(figure)] + ([_number(figure["worst"])] if episodes > 1 else [])
        table.add_row(name, *cells)
    return table


def comparison_table(summaries: Mapping[str, Mapping[str, Any]]) -> Table:
    """Return one column per experiment and one row per figure; a figure that an experiment lacks is left empty."""
    table = Table(title="mean ± standard error (worst)", title_justify="left")
    table.add_column("figure")
    for name, summary in summaries.items():
        table.add_column(f"{name}\n{len(summary['episodes'])} episodes", justify="right")
    for figure in _figures(list(summaries.values())):
        cells = []
        for summary in summaries.values():
            value = summary["aggregate"].get(figure)
            cells.append("" if value is None else f"{_mean(value)} ({_number(value['worst'])})")
        table.add_row(figure, *cells)
    return table


def _figures(summaries: Sequence[Mapping[str, Any]]) -> list[str]:
    return list(dict.fromkeys(name for summary in summaries for name in summary["aggregate"]))


def _mean(figure: Mapping[str, Any]) -> str:
    error = figure["standard_error"]
    return _number(figure["mean"]) + ("" if error is None else f"{MARK}{_number(error)}")


def _number(value: float) -> str:
    return f"{value:.4g}" if abs(value) < 1000 else f"{value:.0f}"
