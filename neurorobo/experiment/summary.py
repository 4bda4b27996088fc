"""The summary of a run: every episode's figures, and their mean, standard error and worst."""

from collections.abc import Collection, Sequence
from math import sqrt
from statistics import fmean, stdev
from typing import Any

from neurorobo.experiment.closed_loop import EpisodeResult


def summarise(results: Sequence[EpisodeResult], higher_is_better: Collection[str]) -> dict[str, Any]:
    """Return ``{"episodes": [...], "aggregate": {figure: {mean, standard_error, worst}}}``, ready for JSON.

    The standard error of a single episode is ``None``: it is not known. Besides their sum, saturations are listed for
    each input that saturated in any of the episodes.
    """
    saturated = sorted({place for result in results for place in result.saturations})
    episodes = [
        {
            "seed": result.seed,
            **result.metrics,
            **{f"firing_rate.{name}": rate for name, rate in result.firing_rates.items()},
            "saturations": sum(result.saturations.values()),
            **{f"saturations.{place}": result.saturations.get(place, 0) for place in saturated},
        }
        for result in results
    ]
    figures = [name for name in episodes[0] if name != "seed"] if episodes else []
    aggregate = {}
    for name in figures:
        values = [float(episode[name]) for episode in episodes]
        error = stdev(values) / sqrt(len(values)) if len(values) > 1 else None
        worst = min(values) if name in higher_is_better else max(values)
        aggregate[name] = {"mean": fmean(values), "standard_error": error, "worst": worst}
    return {"episodes": episodes, "aggregate": aggregate}
