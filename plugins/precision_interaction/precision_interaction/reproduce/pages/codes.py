"""How the comparison of codes is shown."""

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

from precision_interaction.reproduce.codes import (
    HIGHEST_UM_S,
    NEURONS,
    PHASE,
    QUICK_STEPS,
    SIZES,
    TRAINED_SIZES,
    WINDOW,
    Codes,
)
from precision_interaction.reproduce.pages.page import Page, Picture, Presentation, Table, Wanted
from precision_interaction.reproduce.row import Result, Setting

if TYPE_CHECKING:
    from matplotlib.figure import Figure

OURS = "population uniform"
PAPERS = ("Poisson", "time to first spike")
"""The codes that the paper has tried besides."""


def present(results: Mapping[str, Result], setting: Setting) -> Presentation:
    """Show codes and trained networks side by side."""
    wanted = Wanted()
    rms, deviation = (
        {name: _mean(found["trained"][str(NEURONS)], figure) for name, found in results.items()}
        for figure in ("rms", "deviation")
    )
    for name in PAPERS:
        for what, figures in (("accurate", rms), ("repeatable", deviation)):
            ours, others = figures[OURS], figures[name]
            wanted.that(f"{OURS} is less {what} than {name} ({ours:.3g} and {others:.3g})", ours <= others)
    for name, found in results.items():
        if name != "Poisson":  # which states the value of a spike, and not how far it is off
            for trip in found["sizes"]:
                what = f"{name}, {trip['neurons']} neurons: largest error over half the stated resolution"
                wanted.at_most(what, trip["largest_um_s"] / (trip["resolution_um_s"] / 2), 1.0 + 1e-6)
    place = SIZES.index(NEURONS)
    lines = []
    for name, found in results.items():
        trip, trained = found["sizes"][place], found["trained"]
        figures_of_trip = ("resolution_um_s", "rms_um_s", "deviation_um_s", "rate")
        lines.append(
            [
                name,
                *(f"{trip[figure]:.3f}" for figure in figures_of_trip),
                *(_spread(trained[str(size)], "rms") for size in TRAINED_SIZES),
                _spread(trained[str(NEURONS)], "deviation"),
                f"{_mean(trained[str(NEURONS)], 'rate'):.3f}",
            ]
        )
    heads = (
        "code",
        "resolution, um/s",
        "rms error, um/s",
        "between repetitions, um/s",
        "rate",
        *(f"hippocampus of {size}: rms error" for size in TRAINED_SIZES),
        f"hippocampus of {NEURONS}: between repetitions",
        f"hippocampus of {NEURONS}: rate",
    )
    steps = PHASE.steps if not setting.quick else QUICK_STEPS
    caption = (
        f"A speed of 0..{HIGHEST_UM_S:g} um/s in {NEURONS} neurons and {WINDOW} steps. Left: sent and read back. "
        f"Right: the same hippocampus, trained alike for {steps} steps of {PHASE.batch} on this code, one period "
        "ahead, with so many neurons for the speed: the rms error of mean (mN) and variance (mN^2) together, and "
        "the deviation of its answers between repetitions of one speed; means of several seeds, with the least and "
        "the largest. The paper prints no figures."
    )
    sizes = Table(
        ["code", *(f"{size}" for size in SIZES)],
        [
            [name, *(f"{trip['resolution_um_s']:.3f} / {trip['rms_um_s']:.3f}" for trip in found["sizes"])]
            for name, found in results.items()
        ],
        "Stated resolution / rms error in um/s, by the number of neurons.",
    )
    words = (
        "The paper chose the uniform code for its *repeatable accuracy* over Poisson spikes and the time to first "
        "spike. Gaussian receptive fields, as later controllers of robots use them, are compared here as well: "
        "their resolution is a bound, which the error does not reach; that of Poisson spikes is the value of a "
        "spike, which their noise drowns.",
    )
    picture = Picture(
        "codes",
        "Left: rms error of a speed that is sent and read back, by the number of neurons. Right: the rms "
        f"error of a hippocampus trained on each code: dark, of {NEURONS} neurons; light, of {TRAINED_SIZES[0]}. "
        "Dots: the seeds.",
        _draw(results),
        (8.0, 3.4),
    )
    return Presentation(words, [Table(heads, lines, caption), sizes], [picture], wanted.misses)


def _mean(trained: Sequence[Mapping[str, float]], figure: str) -> float:
    return sum(one[figure] for one in trained) / len(trained)


def _spread(trained: Sequence[Mapping[str, float]], figure: str) -> str:
    values = [one[figure] for one in trained]
    return f"{_mean(trained, figure):.2f} ({min(values):.2f} .. {max(values):.2f})"


def _draw(results: Mapping[str, Result]) -> Callable[["Figure"], None]:
    def draw(figure: "Figure") -> None:
        left, right = figure.subplots(1, 2)
        for number, (name, found) in enumerate(results.items()):
            trips = found["sizes"]
            left.loglog(
                [trip["neurons"] for trip in trips], [trip["rms_um_s"] for trip in trips], "o-", ms=3, label=name
            )
            for size, height, strength in zip(TRAINED_SIZES, (-0.2, 0.2), (0.5, 1.0), strict=True):
                trained = found["trained"][str(size)]
                errors = [one["rms"] for one in trained]
                right.barh(number + height, _mean(trained, "rms"), 0.36, color=f"C{number}", alpha=strength)
                right.plot(errors, [number + height] * len(errors), ".", color="black", ms=4)
        left.set_xlabel("neurons")
        left.set_ylabel("rms error, µm/s")
        left.legend(fontsize=7)
        right.set_yticks(range(len(results)), list(results))
        right.invert_yaxis()
        right.set_xlabel("error of the hippocampus, mN and mN²")

    return draw


PAGE = Page(
    Codes(),
    title="Input codes compared",
    paper="Sec. IV-A",
    minutes=1.3,
    present=present,
)
