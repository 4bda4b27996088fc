"""Eyeblink conditioning of a spiking cerebellum: acquisition, timing, extinction and savings, and their controls.

Run ``python benchmarks/paradigms/eyeblink.py`` (ten minutes of one core). It runs ``examples/eyeblink.yaml`` once for
each animal, which is a wiring of its own (seeds 0 to 4), and each condition. Settings were chosen on seeds from 1000,
but for one: that mossy fibres fire regularly and not at random was decided after a look at seed 0. Beside itself it
writes what was found, ``eyeblink.json``, and what the documentation shows of it, ``eyeblink.md`` and ``eyeblink.svg``;
``--draw`` writes these two again from the first.
"""

import argparse
import json
import os
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np
from numpy.typing import NDArray

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
EXAMPLE = ROOT / "examples" / "eyeblink.yaml"
sys.path.insert(0, str(ROOT / "benchmarks"))
os.environ["OMP_NUM_THREADS"] = "1"

from machine import machine  # noqa: E402
from neurorobo_paradigms.eyeblink.conditioning_chamber import ConditioningChamber  # noqa: E402
from neurorobo_paradigms.eyeblink.eyeblink_task import EyeblinkTask, Trial  # noqa: E402

from neurorobo.bodies import Array, Body  # noqa: E402
from neurorobo.config.experiment import load_experiment  # noqa: E402
from neurorobo.experiment.build import build_brain, build_task  # noqa: E402
from neurorobo.experiment.closed_loop import run_episodes  # noqa: E402
from neurorobo.experiment.recorder import Sample  # noqa: E402
from neurorobo.tasks.task import Flags, Task  # noqa: E402

BLOCK = 10
"""Trials with a tone, of which a share is taken."""

CRITERION = 8
"""Conditioned responses in a block that say that the animal has learned."""

LATE = 20
"""Trials at the end of a phase that eyelid traces are means of."""

NO_PARALLEL = "regions.cerebellum.layers.purkinje.synapses.granule.learns.0.learning_rate=0"
NO_NUCLEAR = "regions.cerebellum.layers.nuclei.synapses.mossy.learns.0.learning_rate=0"


@dataclass(frozen=True)
class Condition:
    """What is changed of the example's chamber and of its brain, and the colour in which it is shown."""

    name: str
    colour: str
    chamber: tuple[str, ...] = ()
    brain: tuple[str, ...] = ()


CONDITIONS = (
    Condition("300 ms", "#0a7cc4"),
    Condition("500 ms", "#e08a00", ("body.interval=500 ms",)),
    Condition("unpaired", "#5b6770", ("body.phases=[{name: acquisition, trials: 160, stimuli: unpaired}]",)),
    Condition("300 ms, nuclei do not learn", "#0a9c74", (), (NO_NUCLEAR,)),
    Condition(
        "nothing learns", "#b06fb0", ("body.phases=[{name: acquisition, trials: 40}]",), (NO_PARALLEL, NO_NUCLEAR)
    ),
)
PAIRED = tuple(condition for condition in CONDITIONS if condition.name in ("300 ms", "500 ms"))
SAVED = (*PAIRED, CONDITIONS[3])
PHASES = ("acquisition", "extinction", "reacquisition")


class Chambers(Body):
    """Chambers side by side, each with its own stimuli, so that one run of a brain serves all of them."""

    def __init__(self, chambers: Sequence[ConditioningChamber]) -> None:
        super().__init__(chambers[0].config)
        self.chambers = chambers

    def reset(self, seeds: Sequence[int], which: NDArray[np.bool_] | None = None) -> None:
        """Bring all to their start."""
        for chamber, seed in zip(self.chambers, seeds, strict=True):
            chamber.reset([seed])

    def read(self) -> dict[str, Array]:
        """Return what each reports."""
        readings = [chamber.read() for chamber in self.chambers]
        return {name: np.concatenate([reading[name] for reading in readings]) for name in self.sensors}

    def advance(self, commands: Mapping[str, Array], duration_ns: int) -> None:
        """Move each."""
        for i, chamber in enumerate(self.chambers):
            chamber.advance({name: values[i : i + 1] for name, values in commands.items()}, duration_ns)

    def stop(self) -> None:
        """Stop all."""
        for chamber in self.chambers:
            chamber.stop()


class SideBySide(Task[Chambers]):
    """The tasks of such chambers."""

    def __init__(self, tasks: Sequence[EyeblinkTask]) -> None:
        super().__init__(tasks[0].config, Chambers([task.body for task in tasks]))
        self.tasks = tasks

    def reset(self, batch: int, which: Flags | None = None) -> None:
        """Begin all."""
        for task in self.tasks:
            task.reset(1)

    def observe(self, duration_ns: int, running: Flags) -> None:
        """Look at each."""
        for i, task in enumerate(self.tasks):
            task.observe(duration_ns, running[i : i + 1])

    def reward(self) -> Array:
        """Return the reward of each."""
        return np.concatenate([task.reward() for task in self.tasks])

    def terminated(self) -> Flags:
        """Return which have had all trials."""
        return np.concatenate([task.terminated() for task in self.tasks])

    def truncated(self) -> Flags:
        """Return that none is cut short."""
        return np.concatenate([task.truncated() for task in self.tasks])

    def metrics(self) -> Sequence[dict[str, float]]:
        """Return the figures of each."""
        return [figures for task in self.tasks for figures in task.metrics()]


class Eyelids:
    """Keeps how far the eyes are shut, tick by tick."""

    most_neurons = 0

    def __init__(self) -> None:
        self.closure: list[Array] = []

    def sample(self, sample: Sample) -> None:
        """Take what the chambers report."""
        self.closure.append(sample.observation["closure"][:, 0].copy())


def run(conditions: Sequence[Condition], seed: int) -> list[dict[str, Any]]:
    """Run conditions of one brain side by side, on one animal, and return what it did in each of them."""
    experiments = [
        load_experiment(EXAMPLE, [*condition.chamber, *condition.brain, f"seed={seed}"]) for condition in conditions
    ]
    tasks: list[EyeblinkTask] = [build_task(experiment) for experiment in experiments]  # type: ignore[misc]
    eyelids = Eyelids()
    started = time.process_time()
    run_episodes(build_brain(experiments[0]), SideBySide(tasks), [seed] * len(tasks), recorders=[eyelids])
    seconds = time.process_time() - started
    closure = np.array(eyelids.closure)
    rows = []
    for number, (condition, experiment, task) in enumerate(zip(conditions, experiments, tasks, strict=True)):
        chamber, trials = task.body.config, task.trials(0)
        ticks = chamber.trial // experiment.clock.tick_ns
        traces = closure[: ticks * len(trials), number].reshape(len(trials), ticks)
        rows.append(
            {
                "condition": condition.name,
                "seed": seed,
                "config_hash": experiment.config_hash,
                "side_by_side": len(conditions),
                "cpu_seconds_per_trial": round(seconds * ticks / len(closure), 3),
                "interval_ms": chamber.interval * 1e-6,
                "tone_onset_ms": chamber.tone_onset * 1e-6,
                "tick_ms": experiment.clock.tick_ns * 1e-6,
                "phases": {phase.name: _phase(phase.name, trials, traces) for phase in chamber.phases},
            }
        )
    return rows


def _phase(name: str, trials: Sequence[Trial], traces: Array) -> dict[str, Any]:
    """Return what an animal did in a phase; traces are of trials with a tone, as everything but the puff is."""
    own = [(trial, trace) for trial, trace in zip(trials, traces, strict=True) if trial.phase == name]
    heard = [(trial, trace) for trial, trace in own if trial.tone]
    conditioned = [int(trial.conditioned) for trial, _ in heard]
    late = [trial for trial, _ in heard[-LATE:]]
    onsets = [trial.onset_ms for trial in late if trial.onset_ms is not None]
    return {
        "conditioned": "".join(map(str, conditioned)),
        "trials_to_criterion": trials_to_criterion(conditioned),
        "late_onset_ms": round(fmean(onsets), 1) if onsets else None,
        "late_felt": round(fmean([trial.felt for trial, _ in own[-LATE:]]), 3),
        "late_trace": [round(float(value), 3) for value in np.mean([trace for _, trace in heard[-LATE:]], axis=0)],
    }


def trials_to_criterion(conditioned: Sequence[int]) -> int | None:
    """Return after how many trials the last ten had eight conditioned responses for the first time, if ever."""
    for end in range(BLOCK, len(conditioned) + 1):
        if sum(conditioned[end - BLOCK : end]) >= CRITERION:
            return end
    return None


def peak_ms(row: Mapping[str, Any]) -> float:
    """Return when the eyelid was shut furthest, from the onset of the tone on, late in acquisition on average."""
    return float(np.argmax(_late_trace(row)) * row["tick_ms"])


def half_ms(row: Mapping[str, Any]) -> float:
    """Return when it came to half of that for the first time."""
    trace = _late_trace(row)
    return float(np.argmax(trace >= trace.max() / 2) * row["tick_ms"])


def _late_trace(row: Mapping[str, Any]) -> Array:
    first = round(row["tone_onset_ms"] / row["tick_ms"])
    return np.array(row["phases"]["acquisition"]["late_trace"][first:])


def shares(conditioned: str) -> list[float]:
    """Return the share of conditioned responses in each block, in percent."""
    blocks = [conditioned[start : start + BLOCK] for start in range(0, len(conditioned), BLOCK)]
    return [100.0 * block.count("1") / len(block) for block in blocks]


def of(rows: Sequence[Mapping[str, Any]], condition: str) -> list[Mapping[str, Any]]:
    """Return the rows of a condition."""
    return [row for row in rows if row["condition"] == condition]


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return what was found, a line for each condition and all its animals in each cell."""

    def cell(own: Sequence[Mapping[str, Any]], phase: str, figure: Any) -> str:
        return ", ".join(figure(row["phases"][phase]) for row in own if phase in row["phases"]) or "-"

    def first_and_last(found: Mapping[str, Any]) -> str:
        blocks = shares(found["conditioned"])
        return f"{blocks[0]:.0f}; {blocks[-1]:.0f}"

    def last(found: Mapping[str, Any]) -> str:
        return f"{shares(found['conditioned'])[-1]:.0f}"

    def criterion(found: Mapping[str, Any]) -> str:
        return str(found["trials_to_criterion"] or "never")

    def felt(found: Mapping[str, Any]) -> str:
        return f"{100 * found['late_felt']:.0f}"

    heads = (
        "condition",
        "responses in the first; the last block of acquisition, %",
        "the last block of extinction, %",
        "half shut; shut furthest, ms after the tone's onset",
        "puff felt, %",
        "trials to criterion: first time",
        "second time",
    )
    lines = [f"| {' | '.join(heads)} |", f"|{' --- |' * len(heads)}"]
    for condition in CONDITIONS:
        own = of(rows, condition.name)
        learned = condition.name not in ("unpaired", "nothing learns")
        cells = [
            cell(own, "acquisition", first_and_last),
            cell(own, "extinction", last),
            ", ".join(f"{half_ms(row):.0f}; {peak_ms(row):.0f}" for row in own) if learned else "-",
            cell(own, "acquisition", felt) if condition.name != "unpaired" else "-",
            cell(own, "acquisition", criterion),
            cell(own, "reacquisition", criterion),
        ]
        lines.append(f"| {condition.name} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def draw(rows: Sequence[Mapping[str, Any]], file: Path) -> None:
    """Draw learning curves, eyelid traces and savings; of an SVG or a PNG file, by its name."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context(
        {
            "svg.hashsalt": "eyeblink",
            "svg.fonttype": "none",
            "font.size": 9,
            "axes.spines.top": False,
            "axes.spines.right": False,
            "legend.frameon": False,
            "legend.fontsize": 8,
        }
    ):
        figure = Figure(figsize=(10.5, 3.4), layout="constrained")
        learning, timing, savings = figure.subplots(1, 3, width_ratios=(1.9, 1.3, 1.0))
        _draw_learning(learning, rows)
        _draw_timing(timing, rows)
        _draw_savings(savings, rows)
        for letter, panel in zip("abc", (learning, timing, savings), strict=True):
            panel.set_title(letter, loc="left", fontweight="bold")
        metadata = {"Date": None} if file.suffix == ".svg" else {}
        figure.savefig(file, metadata=metadata, dpi=150)


def _draw_learning(panel: Any, rows: Sequence[Mapping[str, Any]]) -> None:
    starts = {}
    end = 0
    for phase in PHASES:
        starts[phase] = end
        end += max((len(row["phases"][phase]["conditioned"]) for row in rows if phase in row["phases"]), default=0)
        middle = (starts[phase] + end) / 2
        panel.text(middle, 104, phase, ha="center", va="bottom", fontsize=8, color="#5b6770")
        if starts[phase]:
            panel.axvline(starts[phase], color="#5b6770", linewidth=0.8, linestyle=":")
    for condition in CONDITIONS:
        if condition in SAVED and condition not in PAIRED:  # it is in the panel of savings
            continue
        for number, phase in enumerate(PHASES):
            own = [
                shares(row["phases"][phase]["conditioned"])
                for row in of(rows, condition.name)
                if phase in row["phases"]
            ]
            if not own:
                continue
            trials = starts[phase] + BLOCK * (np.arange(len(own[0])) + 0.5)
            for each in own:
                panel.plot(trials, each, color=condition.colour, linewidth=0.5, alpha=0.4)
            label = None if number else condition.name
            panel.plot(trials, np.mean(own, axis=0), "o-", color=condition.colour, markersize=3, label=label)
    panel.set(xlabel="trial", ylabel="conditioned responses, %", xlim=(0, end), ylim=(-4, 104))
    panel.legend(loc="center", bbox_to_anchor=(0.37, 0.42), handlelength=1.2)


def _draw_timing(panel: Any, rows: Sequence[Mapping[str, Any]]) -> None:
    for condition in PAIRED:
        own = of(rows, condition.name)
        traces = np.array([row["phases"]["acquisition"]["late_trace"] for row in own])
        times = np.arange(traces.shape[1]) * own[0]["tick_ms"] - own[0]["tone_onset_ms"]
        for trace in traces:
            panel.plot(times, trace, color=condition.colour, linewidth=0.5, alpha=0.4)
        panel.plot(times, traces.mean(0), color=condition.colour, linewidth=2, label=condition.name)
        panel.axvline(own[0]["interval_ms"], color=condition.colour, linestyle="--", linewidth=1)
    panel.axvline(0, color="#5b6770", linewidth=0.8, linestyle=":")
    panel.text(0, 1.02, "tone", ha="center", va="bottom", fontsize=8, color="#5b6770")
    for condition in PAIRED:
        interval_ms = of(rows, condition.name)[0]["interval_ms"]
        panel.text(interval_ms, 1.02, "puff", ha="center", va="bottom", fontsize=8, color=condition.colour)
    panel.set(xlabel="time from the tone's onset, ms", ylabel="closure of the eye", ylim=(-0.02, 1.02))


def _draw_savings(panel: Any, rows: Sequence[Mapping[str, Any]]) -> None:
    for place, condition in enumerate(SAVED):
        for row in of(rows, condition.name):
            found = [row["phases"][phase]["trials_to_criterion"] for phase in ("acquisition", "reacquisition")]
            if None not in found:
                panel.plot([3 * place, 3 * place + 1], found, "o-", color=condition.colour, markersize=3, linewidth=1)
    panel.set_xticks([0, 1, 3, 4, 6, 7], ["1st", "2nd"] * 3, fontsize=8)
    for place, (condition, words) in enumerate(
        zip(SAVED, ("300 ms", "500 ms", "300 ms, nuclei\ndo not learn"), strict=True)
    ):
        panel.text(
            3 * place + 0.5,
            -0.13,
            words,
            ha="center",
            va="top",
            fontsize=8,
            color=condition.colour,
            transform=panel.get_xaxis_transform(),
        )
    panel.set(ylabel="trials to criterion", xlim=(-0.6, 7.6))
    panel.set_ylim(bottom=0)


def publish(rows: Sequence[Mapping[str, Any]], folder: Path) -> None:
    """Write what the documentation shows."""
    (folder / "eyeblink.md").write_text(table(rows))
    draw(rows, folder / "eyeblink.svg")


def main() -> int:
    """Run, write and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5, help="how many animals, from seed --first on")
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--draw", action="store_true", help="only table and figure, of what was found before")
    parser.add_argument("--out", type=Path, default=HERE)
    arguments = parser.parse_args()
    file = arguments.out / "eyeblink.json"
    if not arguments.draw:
        started, rows = time.process_time(), []
        for _, group in groupby(CONDITIONS, key=lambda condition: condition.brain):
            conditions = [*group]
            for seed in range(arguments.first, arguments.first + arguments.seeds):
                for row in run(conditions, seed):
                    rows.append(row)
                    print(row["condition"], seed, row["phases"]["acquisition"]["conditioned"], flush=True)
                minutes = round((time.process_time() - started) / 60, 1)
                found = {"machine": machine(), "cpu_minutes": minutes, "rows": rows}
                file.write_text(json.dumps(found) + "\n")
    rows = json.loads(file.read_text())["rows"]
    publish(rows, arguments.out)
    print(table(rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
