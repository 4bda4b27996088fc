"""Fig. 7: how fast the regions fire, what that costs, and what a network that does not spike would cost."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import torch

from neurorobo.config.experiment import Experiment, load_experiment
from neurorobo.experiment.build import build_brain, build_task
from neurorobo.experiment.weights import weights_file
from neurorobo.graph.brain import Brain
from neurorobo.regions.region import Region
from neurorobo.tasks.supervised import SupervisedTask
from precision_interaction.reproduce.operations import (
    ACCUMULATE_PJ,
    MULTIPLY_ACCUMULATE_PJ,
    Array,
    Listener,
    Synapses,
    Window,
    circuit_of,
    dense_pJ,
    spiking_pJ,
    synapses,
)
from precision_interaction.reproduce.row import Picture, Presentation, Result, Row, Setting, Table, Wanted

if TYPE_CHECKING:
    from matplotlib.figure import Figure

EXAMPLE = "peg_in_hole.yaml"
INSERTIONS, REST = "insertions", "at rest"
REGIONS = {"hippocampus": "0.26 ± 0.08", "cerebellum": "0.34 ± 0.08", "prefrontal_cortex": "0.37 ± 0.20"}
PAPER_MEAN = "0.33"
MOST_RATE = 0.20
WINDOWS = 256
EPISODES, QUICK_EPISODES = 12, 2
BINS = 20


class FiringRates(Row):
    """Spikes, operations and energy of recorded insertions."""

    name: ClassVar[str] = "rates"
    title: ClassVar[str] = "Firing rates, synaptic operations and energy"
    paper: ClassVar[str] = "Fig. 7"
    minutes: ClassVar[float] = 0.5

    def cells(self, setting: Setting) -> Sequence[str]:
        """Return what the brain does while it is listened to."""
        return (INSERTIONS, REST)

    def files(self, setting: Setting) -> Sequence[Path]:
        """Return the example and the shipped weights."""
        experiment = self._experiment(setting)
        return [
            setting.examples / EXAMPLE,
            *(weights_file(name, experiment) for name, config in experiment.regions.items() if config.weights),
        ]

    def measure(self, cell: str, setting: Setting) -> Result:
        """Listen to the brain."""
        experiment = self._experiment(setting)
        brain = build_brain(experiment)
        if cell == REST:
            return {name: _at_rest(brain.region(name)) for name in REGIONS}
        projections = _projections(brain)
        episodes = QUICK_EPISODES if setting.quick else EPISODES
        windows, periods = listen(brain, experiment, projections, range(episodes))
        found: dict[str, Any] = {}
        for name in REGIONS:
            of_region = [window for window in windows if window.region == name]
            layers = list(of_region[0].spikes)
            rates = {layer: _rates(of_region, layer, brain.plan.clock.window) for layer in layers}
            chosen = np.linspace(0, len(rates[layers[0]]) - 1, WINDOWS).round().astype(int)
            every = np.concatenate([rates[layer][chosen] for layer in layers], axis=1)
            neurons = every.mean(0)
            uses = len(rates[layers[0]]) / periods
            found[name] = {
                "mean": float(every.mean()),
                "deviation_of_windows": float(every.mean(1).std()),
                "deviation_of_neurons": float(neurons.std()),
                "deviation": float(every.std()),
                "layers": {layer: float(rates[layer][chosen].mean()) for layer in layers},
                "neurons": every.shape[1],
                "windows": np.round(every.mean(1), 5).tolist(),
                "histogram": np.histogram(neurons, BINS, (0.0, 1.0))[0].tolist(),
                "uses": uses,
                "updates": uses * every.shape[1] * brain.plan.clock.window,
                "operations": {
                    one.name: float(sum(w.operations[one.name][torch.from_numpy(w.running)].sum() for w in of_region))
                    / periods
                    for one in projections[name]
                },
                "synapses": {one.name: one.count for one in projections[name]},
            }
        return {"periods": periods, "steps": brain.plan.clock.window, "regions": found}

    def present(self, results: Mapping[str, Result], setting: Setting) -> Presentation:
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

    def _experiment(self, setting: Setting) -> Experiment:
        return load_experiment(setting.examples / EXAMPLE)


def listen(
    brain: Brain, experiment: Experiment, projections: Mapping[str, list[Synapses]], seeds: Sequence[int]
) -> tuple[list[Window], int]:
    """Run an insertion for each seed; return all windows of the spiking regions, and how many periods there were."""
    task = build_task(experiment)
    assert task is not None
    supervised, batch = SupervisedTask(task), len(seeds)
    running = np.ones(batch, dtype=np.bool_)
    listener, periods = Listener(projections, running), 0
    state = brain.init_state(seeds)
    with torch.inference_mode():
        supervised.reset(seeds, batch)
        while running.any():
            listener.running = running
            read = {k: torch.as_tensor(v, dtype=torch.float32) for k, v in supervised.body.read().items()}
            commands, state = brain.tick(read, state, listener)
            wanted = {name: value.numpy().astype(np.float64) for name, value in commands.items()}
            _, ended = supervised.step(wanted, brain.plan.clock.tick_ns, running)
            periods += int(running.sum())
            running = running & ~ended
    return listener.windows, periods


def _projections(brain: Brain) -> dict[str, list[Synapses]]:
    circuits = {name: circuit_of(brain.region(name)) for name in REGIONS}
    return {name: list(synapses(circuit)) for name, circuit in circuits.items() if circuit is not None}


def _rates(windows: Sequence[Window], layer: str, steps: int) -> Array:
    """Return spikes per step (windows of running episodes, neurons) of a layer."""
    return np.concatenate([window.spikes[layer].numpy()[window.running] for window in windows]).astype(float) / steps


def _at_rest(region: Region) -> dict[str, float]:
    """Return the firing rate of a region without any input spike, and with inputs that read zero."""
    steps, silent, zero = region.clock.window, {}, {}
    for name, port in region.input_ports.items():
        values = torch.zeros(1, port.width)
        silent[name] = values if port.code is None else torch.zeros(steps, 1, port.channels)
        zero[name] = values if port.code is None else port.code.encode(values, steps)
    return {"no_spikes": _rate(region, silent), "zero": _rate(region, zero)}


def _rate(region: Region, inputs: Mapping[str, torch.Tensor]) -> float:
    heard: list[torch.Tensor] = []
    with torch.inference_mode():
        region.step(inputs, region.init_state(1), lambda layer, spikes: heard.append(spikes.mean((0, 1))))
    return float(torch.cat(heard).mean())


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
