"""How Fig. 7 is shown."""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from precision_interaction.reproduce.firing_rates import BINS, INSERTIONS, REGIONS, REST, WINDOWS, FiringRates
from precision_interaction.reproduce.operations import (
    ACCUMULATE_PJ,
    MULTIPLY_ACCUMULATE_PJ,
    Array,
    dense_pJ,
    spiking_pJ,
)
from precision_interaction.reproduce.pages.page import Page, Picture, Presentation, Table, Wanted
from precision_interaction.reproduce.row import Result, Setting

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PAPER_MEAN = "0.33"
MOST_RATE = 0.20


def present(results: Mapping[str, Result], setting: Setting) -> Presentation:
    """Show rates, what happens at rest, operations and energy."""
    regions, wanted = results[INSERTIONS]["regions"], Wanted()
    mean = float(np.mean([found["mean"] for found in regions.values()]))
    wanted.at_most("mean firing rate of the three regions", mean, MOST_RATE)
    for name in REGIONS:
        wanted.at_most(f"{name}: rate without an input spike", results[REST][name]["no_spikes"], 0.0)
    tables = [_rate_table(regions, results[REST], mean), _operation_table(regions), _energy_table(results)]
    silent = [name for name in REGIONS if results[REST][name]["zero"] == 0]
    spiking, once, each = _energies(results)
    break_even = MULTIPLY_ACCUMULATE_PJ / (ACCUMULATE_PJ * results[INSERTIONS]["steps"])
    words = (
        f"Rates count the neurons inside and at the output of a region, over {WINDOWS} windows of recorded "
        "insertions, and leave out those of the input code. *At rest* has two meanings. Without a single input "
        "spike nothing fires in any region, as neurons have no bias. Where every input *reads zero*, only "
        f"{'the ' + ', the '.join(silent) if silent else 'no region'} stays silent: its codes start at zero, and a "
        "zero is no spike, as in the gap before the first contact. A code of a force or a velocity reaches to both "
        "sides of zero, so that zero is a rate of one half at its input, and the region behind it goes on firing.",
        "The energy is one of arithmetic alone. Against the same network of units that do not spike, but are "
        f"computed at each step of the window, spikes need {each / spiking:.1f} times less; against one that is "
        f"computed once a window, they need {spiking / once:.1f} times as much: a window of "
        f"{results[INSERTIONS]['steps']} steps asks for a rate below {break_even:.2f} to be cheaper than that. "
        "Memory, in which most of the energy of either would go, is left out.",
    )
    picture = Picture(
        "fig07",
        f"Fig. 7: firing rates over {WINDOWS} windows. Left: mean of the region in each window. Right: how its "
        "neurons' rates are distributed; dotted: the mean, dashed: the paper's.",
        _draw(regions),
        (7.5, 4.6),
    )
    return Presentation(words, tables, [picture], wanted.misses)


def _rate_table(regions: Mapping[str, Any], rest: Result, mean: float) -> Table:
    lines = []
    for name, paper in REGIONS.items():
        found = regions[name]
        layers = ", ".join(f"{layer} {rate:.2f}" for layer, rate in found["layers"].items())
        lines.append(
            [
                name,
                paper,
                f"{found['mean']:.3f} ± {found['deviation']:.3f}",
                f"{found['deviation_of_windows']:.3f}",
                f"{found['deviation_of_neurons']:.3f}",
                f"{rest[name]['no_spikes']:.3f} / {rest[name]['zero']:.3f}",
                layers,
            ]
        )
    lines.append(["mean", PAPER_MEAN, f"{mean:.3f}", "", "", "", ""])
    heads = ("region", "paper", "ours", "of windows", "of neurons", "no spikes / zeros", "layers")
    caption = (
        "Spikes per neuron and step: mean ± deviation over all windows and neurons, and the deviations of the windows' "
        "and of the neurons' means; the rate without input spikes and with inputs that read zero; mean of each layer."
    )
    return Table(heads, lines, caption)


def _operation_table(regions: Mapping[str, Any]) -> Table:
    lines = []
    for name, found in regions.items():
        for projection, operations in found["operations"].items():
            count = found["synapses"][projection]
            lines.append([name, projection, f"{count:,}", f"{found['uses']:.0f}", f"{operations / 1e6:.3f}"])
    heads = ("region", "projection", "synapses", "uses a period", "operations a period, million")
    caption = "Synaptic operations: each spike times the synapses that it reaches, those of the input code included."
    return Table(heads, lines, caption)


def _figures(results: Mapping[str, Result], name: str) -> Array:
    """Return operations, updates and the three energies (pJ) of a region in a control period."""
    region, steps = results[INSERTIONS]["regions"][name], results[INSERTIONS]["steps"]
    operations = sum(region["operations"].values())
    once = dense_pJ(region["uses"] * sum(region["synapses"].values()))
    return np.array([operations, region["updates"], spiking_pJ(operations, region["updates"]), once, once * steps])


def _energies(results: Mapping[str, Result]) -> tuple[float, float, float]:
    """Return the energy (pJ) of all regions: spiking, dense once a window, dense at each step."""
    spiking, once, each = np.sum([_figures(results, name) for name in REGIONS], axis=0)[2:]
    return float(spiking), float(once), float(each)


def _energy_table(results: Mapping[str, Result]) -> Table:
    figures = {name: _figures(results, name) for name in REGIONS}
    figures["all"] = np.sum(list(figures.values()), axis=0)
    steps = results[INSERTIONS]["steps"]
    lines = [[name, *(f"{value / 1e6:.2f}" for value in row)] for name, row in figures.items()]
    heads = (
        "region",
        "operations, million",
        "updates, million",
        "spiking, uJ",
        "dense once, uJ",
        "dense each step, uJ",
    )
    caption = (
        f"A control period. Each synaptic operation is an accumulation of {ACCUMULATE_PJ} pJ, each update of a neuron "
        f"a multiplication and accumulation of {MULTIPLY_ACCUMULATE_PJ} pJ (32 bits, 45 nm, without memory: Horowitz, "
        "ISSCC 2014). The same network of units that do not spike takes one multiplication and accumulation for each "
        f"synapse, either once a window or at each of its {steps} steps. An estimate of arithmetic, not a measurement."
    )
    return Table(heads, lines, caption)


def _draw(regions: Mapping[str, Any]) -> Callable[["Figure"], None]:
    def draw(figure: "Figure") -> None:
        panels = figure.subplots(len(regions), 2, sharex="col", width_ratios=(2, 1))
        edges = np.linspace(0.0, 1.0, BINS + 1)
        for number, ((name, found), row) in enumerate(zip(regions.items(), panels, strict=True)):
            row[0].plot(range(1, WINDOWS + 1), found["windows"], color=f"C{number}", lw=0.9)
            row[0].set_ylim(0, 0.6)
            row[0].set_ylabel("rate")
            row[0].set_title(name.replace("_", " "), loc="left", fontsize=9)
            share = np.array(found["histogram"]) / found["neurons"]
            row[1].bar(edges[:-1], share, 1 / BINS, align="edge", color=f"C{number}", alpha=0.6)
            row[1].axvline(found["mean"], color="black", ls=":", lw=1)
            row[1].axvline(float(REGIONS[name].split()[0]), color="black", ls="--", lw=1)
            row[1].set_ylabel("neurons")
        panels[-1, 0].set_xlabel("window")
        panels[-1, 1].set_xlabel("rate of a neuron")

    return draw


PAGE = Page(
    FiringRates(), title="Firing rates, synaptic operations and energy", paper="Fig. 7", minutes=0.05, present=present
)
