"""What makes a log, or a law fitted to it, doubtful, said in words: units, single insertions, and laws that do not fit.

A doubt is no fault: another rig than the paper's may be as it says.
"""

from collections.abc import Iterator

import numpy as np

from precision_interaction import table_one
from precision_interaction.identification.analysis import Analysis, ContactFit, Histogram, LineFit, quantile
from precision_interaction.identification.log import INCREMENTS, STEP, Array, ContactLog

PLAUSIBLE_STEPS_UM = (0.5, table_one.LENGTH_UM)
"""Of the longest step: it is longer than the elevator's resolution, and fits into the hole."""

PLAUSIBLE_FACTOR = 30.0
"""Wrong prefixes err by 1000; a contact may well be this much softer or harder than the paper's."""

OUTLYING, OF_FEW = 7.0, 10.0
"""Deviations of the other insertions, as many more of few as their deviation is less sure: 7 (1 + 10 / n)."""

LEAST_OF_GAUSSIAN, LEAST_OF_LINE = 0.5, 0.8
"""R^2: what explains less is told, if chance does not explain it."""

CHANCE = 4.0
"""What a fit misses, as multiples of what it misses on average by chance."""

MOST_NAMED = 5


def doubts(log: ContactLog, analysis: Analysis, fit: ContactFit) -> Iterator[str]:
    """Yield what whoever made the log should look at."""
    yield from _units(log, analysis)
    if analysis.coarse:
        yield (
            f"the log counts forces in {analysis.count_mN:.3g} mN, wider than the contact's own deviation at some "
            "step; means are off by up to half of it and variances are too large there, so filter the sensor"
        )
    yield from _outliers(log, analysis)
    if not analysis.coarse:
        yield from _gaussians(analysis)
    if len(analysis.step_um) == 1:
        yield (
            f"all steps are {analysis.step_um[0]:g} um, so that nothing tells how force and variance grow with the "
            "step; log others too, over the range that the controller will use"
        )
    yield from _lines(analysis, fit)


def _units(log: ContactLog, analysis: Analysis) -> Iterator[str]:
    longest_um = float(analysis.step_um[-1])
    least_um, most_um = PLAUSIBLE_STEPS_UM
    if not least_um <= longest_um <= most_um:
        unit = "mm" if longest_um < least_um else "nm"
        yield (
            f"the longest step is {longest_um:g} um, where {least_um:g} to {most_um:g} are expected; if {STEP} is in "
            f"{unit}, or in another unit, convert it to um"
        )
        return
    force_mN = float(np.median(np.hypot(*log.of(longest_um)[:, :2].T)))
    paper_mN = longest_um * float(np.hypot(*table_one.PROPORTIONAL_MEAN_MN_UM[:2]))
    if not paper_mN / PLAUSIBLE_FACTOR <= force_mN <= paper_mN * PLAUSIBLE_FACTOR:
        unit, factor = ("N", "1000") if force_mN < paper_mN else ("uN", "0.001")
        yield (
            f"{longest_um:g} um add {force_mN:.3g} mN, where the paper's rig has {paper_mN:.3g}; if the forces are in "
            f"{unit}, multiply them by {factor} to have mN, as {INCREMENTS[0]} says"
        )


def _outliers(log: ContactLog, analysis: Analysis) -> Iterator[str]:
    """Yield one note about the insertions that lie far from the others of their step, the farthest first."""
    found: list[tuple[float, int, str]] = []
    for step_um in analysis.step_um:
        rows = np.flatnonzero(log.step_um == step_um)
        for name, sample in zip(INCREMENTS, log.increment_mN[rows].T, strict=False):
            middle = float(np.median(sample))
            off = np.abs(sample - middle)
            suspect = off > OUTLYING * max(1.4826 * float(np.median(off)), analysis.count_mN)
            deviation = max(float(sample[~suspect].std(ddof=1)), analysis.count_mN)
            far = off / (deviation * (1 + OF_FEW / len(sample)))
            for row in np.flatnonzero(suspect & (far > OUTLYING)):
                place = f"{log.place(int(rows[row]))}: {name} {sample[row]:g}, median at {step_um:g} um {middle:.3g}"
                found.append((float(far[row]), int(rows[row]), place))
    if found:
        number = len({row for _, row, _ in found})
        places = [place for *_, place in sorted(found, reverse=True)[:MOST_NAMED]]
        more = ", ..." if len(found) > MOST_NAMED else ""
        yield (
            f"{number} of {len(log.step_um)} insertions {'lies' if number == 1 else 'lie'} far from the others of the "
            f"same step and may bend the law; look at them, and remove what is a fault: {', '.join(places)}{more}"
        )


def _gaussians(analysis: Analysis) -> Iterator[str]:
    """Yield one note about the steps at which the increments are not Gaussian, which is how a rig draws them."""
    bad = [
        f"{name} at {step_um:g} um (R^2 {of_axis.r_squared:.3f})"
        for step_um, of_step, count in zip(analysis.step_um, analysis.histograms, analysis.repetitions, strict=True)
        for name, of_axis in zip("xy", of_step, strict=False)
        if of_axis.r_squared < LEAST_OF_GAUSSIAN and _missed(of_axis) > CHANCE * _missed_by_chance(of_axis, count)
    ]
    if bad:
        yield (
            f"increments are not Gaussian: {', '.join(bad)}; a rig with this contact would draw others than were "
            "measured, so look at these steps for jumps, stuck parts or two ways to insert"
        )


def _missed(of_axis: Histogram) -> float:
    return float(((of_axis.share - of_axis.gaussian) ** 2).sum())


def _missed_by_chance(of_axis: Histogram, count: float) -> float:
    """Return what shares of so many draws from the Gaussian itself miss on average."""
    return float((of_axis.gaussian * (1 - of_axis.gaussian)).sum() / count)


def _lines(analysis: Analysis, fit: ContactFit) -> Iterator[str]:
    """Yield a note for each line that leaves much of what it should explain, and where it is off most."""
    count = analysis.repetitions[:, None]
    counted_mN = analysis.count_mN if analysis.coarse else 0.0  # what a sensor that is not filtered may add
    variance = np.maximum(analysis.variance_mN2, fit.variance.at(analysis.step_um))
    quantities: tuple[tuple[str, str, LineFit, Array, Array], ...] = (
        ("mean", "mN", fit.mean, analysis.mean_mN, np.sqrt(variance / count) + counted_mN / 2),
        (
            "variance",
            "mN^2",
            fit.variance,
            analysis.variance_mN2,
            variance * np.sqrt(2 / (count - 1)) + counted_mN**2 / 4,
        ),
    )
    for quantity, unit, line, found, error in quantities:
        fitted = line.at(analysis.step_um)
        for axis, name in enumerate("xyz"[: found.shape[1]]):
            off = np.abs(found - fitted)[:, axis]
            spread = ((found[:, axis] - found[:, axis].mean()) ** 2).sum()
            r_squared = 1.0 - float((off**2).sum() / spread) if spread > 0 else 1.0
            beyond = off > quantile(len(off)) * error[:, axis]
            if r_squared < LEAST_OF_LINE and beyond.any():
                at = int(np.argmax(off))
                yield (
                    f"the law does not fit the {quantity} of {name}: R^2 over the steps is {r_squared:.3f}, and it is "
                    f"off most at {analysis.step_um[at]:g} um, {fitted[at, axis]:.3g} {unit} in place of "
                    f"{found[at, axis]:.3g}; look at the log there, or at another `--law`"
                )
