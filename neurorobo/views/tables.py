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


def _figures(summaries: Sequence[Mapping[str, Any]]) -> list[str]:
    return list(dict.fromkeys(name for summary in summaries for name in summary["aggregate"]))


def _episodes(summary: Mapping[str, Any]) -> str:
    count = len(summary["episodes"])
    return f"{count} episode{'s' if count != 1 else ''}"


def _mean(figure: Mapping[str, Any]) -> str:
    error = figure["standard_error"]
    return _number(figure["mean"]) + ("" if error is None else f"{MARK}{_number(error, 2)}")


def _number(value: float, digits: int = 4) -> str:
    return f"{value:.{digits}g}" if abs(value) < 10 ** (digits - 1) else f"{value:.0f}"
