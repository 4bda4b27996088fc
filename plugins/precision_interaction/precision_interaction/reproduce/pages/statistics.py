"""Means with their confidence."""

from collections.abc import Sequence

import numpy as np

DRAWS = 2000


def interval(values: Sequence[float], seed: int = 0) -> tuple[float, float, float]:
    """Return the mean and the ends of its 95 % interval, from a bootstrap of ``values``."""
    sample = np.asarray(values, dtype=np.float64)
    if len(sample) < 2:
        return float(sample.mean()), float("nan"), float("nan")
    generator = np.random.default_rng(seed)
    means = sample[generator.integers(len(sample), size=(DRAWS, len(sample)))].mean(1)
    low, high = np.percentile(means, [2.5, 97.5])
    return float(sample.mean()), float(low), float(high)


def quotient(over: Sequence[float], under: Sequence[float], seed: int = 0) -> tuple[float, float, float]:
    """Return the quotient of two means and the ends of its 95 % interval, from a bootstrap over the pairs."""
    pairs = np.array([over, under], dtype=np.float64)
    generator = np.random.default_rng(seed)
    means = pairs[:, generator.integers(pairs.shape[1], size=(DRAWS, pairs.shape[1]))].mean(2)
    low, high = np.percentile(means[0] / means[1], [2.5, 97.5])
    return float(pairs[0].mean() / pairs[1].mean()), float(low), float(high)


def cell(values: Sequence[float], digits: int = 1) -> str:
    """Return the mean with its interval, as it stands in a table."""
    mean, low, high = interval(values)
    if np.isnan(low) or f"{low:.{digits}f}" == f"{high:.{digits}f}":
        return f"{mean:.{digits}f}"
    return f"{mean:.{digits}f} [{low:.{digits}f}, {high:.{digits}f}]"
