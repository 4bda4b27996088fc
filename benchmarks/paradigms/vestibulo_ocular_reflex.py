"""How far, how fast and at which frequencies a spiking cerebellum adapts the vestibulo-ocular reflex.

Run ``python benchmarks/paradigms/vestibulo_ocular_reflex.py`` (eleven minutes of one core). For each seed, which
draws the network and the noise, it takes `examples/vestibulo_ocular_reflex.yaml` through the protocol below: with a
wanted gain of 1.5 (up) and of 0.5 (down), and as controls 1.5 without mossy fibres that tell of the past (undelayed)
and without plasticity (fixed). It prints a table, and writes beside itself all cycles as JSON and a figure; the table
of the page `docs/how_to/adapt_a_reflex.md` is kept up to date. Stopped at any time, the same command goes on;
``--fresh`` measures all anew.
"""

import argparse
import hashlib
import json
import math
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import accumulate
from pathlib import Path
from statistics import fmean
from typing import Any

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
sys.path.insert(0, str(ROOT / "benchmarks"))

import torch  # noqa: E402
from machine import machine  # noqa: E402

from neurorobo.config.experiment import Experiment, load_experiment  # noqa: E402
from neurorobo.experiment.build import build_brain, build_task  # noqa: E402
from neurorobo.experiment.closed_loop import run_episodes  # noqa: E402
from neurorobo.experiment.plan import build_plan  # noqa: E402
from neurorobo.plugins import Registry  # noqa: E402

EXAMPLE = ROOT / "examples" / "vestibulo_ocular_reflex.yaml"
PAGE = ROOT / "docs" / "how_to" / "adapt_a_reflex.md"
RESULT = HERE / "vestibulo_ocular_reflex.json"
FIGURE = HERE / "vestibulo_ocular_reflex.svg"

LEARNT_HZ = 1.0
TESTS_HZ = {0.25: 3, 0.5: 4, 1.0: 5, 2.0: 10}
"""The frequencies of the tests in the dark, each with the same velocity of the head, and their cycles."""

RULE = "regions.flocculus.layers.purkinje.synapses.granule.learns.0"
DELAYED = ("head_60_ms", "head_120_ms", "head_180_ms", "head_240_ms", "head_300_ms")
CONDITIONS: dict[str, tuple[float, list[str]]] = {
    "up": (1.5, []),
    "down": (0.5, []),
    "undelayed": (1.5, [f"steps.0.correct.{name}=body.head" for name in DELAYED]),
    "fixed": (1.5, [f"{RULE}.learning_rate=0"]),
}
"""The wanted gain of each condition, and what it changes of the example."""

CONTROLS = ("undelayed", "fixed")

Row = Mapping[str, Any]


def tests(when: str) -> dict[str, Any]:
    """Return the phases of a test in the dark at all frequencies."""
    return {
        test(when, frequency_Hz): {
            "frequency": f"{frequency_Hz:g} Hz",
            "amplitude": f"{5.0 / frequency_Hz:g} deg",
            "cycles": cycles,
        }
        for frequency_Hz, cycles in TESTS_HZ.items()
    }


def test(when: str, frequency_Hz: float) -> str:
    """Return the name of a test."""
    return f"{when}_{frequency_Hz * 1000:.0f}_mHz"


def protocol(condition: str) -> dict[str, Any]:
    """Return the phases: what is natural is learned, then tested, then what is wanted, which is tested again.

    But for the controls, a minute of rotation in the dark follows, and one in which the gain is to be 1 again.
    """
    wanted, _ = CONDITIONS[condition]
    phases = {"natural": {"wanted_gain": 1.0, "cycles": 30}, **tests("before")}
    phases |= {"learning": {"wanted_gain": wanted, "cycles": 90}, **tests("after")}
    if condition not in CONTROLS:
        phases |= {"dark": {"cycles": 60}, "back": {"wanted_gain": 1.0, "cycles": 60}, "end": {"cycles": 5}}
    return phases


def experiment(condition: str, seed: int, registry: Registry) -> Experiment:
    """Return the example, as the condition and the seed change it."""
    _, changes = CONDITIONS[condition]
    phases = f"body.phases={json.dumps(protocol(condition))}"
    return load_experiment(EXAMPLE, [f"seed={seed}", "record=[]", phases, *changes], registry)


def fingerprint(prepared: Experiment) -> str:
    """Return the SHA-256 of all that the file and its changes say, by which a result knows what it is of."""
    return hashlib.sha256(json.dumps(prepared.document.value, sort_keys=True).encode()).hexdigest()


def measure(condition: str, seed: int, prepared: Experiment) -> Row:
    """Run the protocol and return all cycles."""
    task = build_task(prepared)
    assert task is not None
    run_episodes(build_brain(prepared, build_plan(prepared)), task, [seed])
    phases = {
        name: {
            "gain": [round(cycle.gain, 4) for cycle in cycles],
            "phase_deg": [round(cycle.phase_deg, 2) for cycle in cycles],
            "slip_deg_s": [None if math.isnan(cycle.slip_deg_s) else round(cycle.slip_deg_s, 3) for cycle in cycles],
        }
        for name, cycles in task.cycles(0).items()  # type: ignore[attr-defined]
    }
    return {"condition": condition, "seed": seed, "said_sha256": fingerprint(prepared), "phases": phases}


def settled(row: Row, phase: str, figure: str = "gain") -> float:
    """Return a figure's mean over the second half of a test, behind what comes of its beginning."""
    values = row["phases"][phase][figure]
    return fmean(values[len(values) // 2 :])


def halfway(row: Row, phase: str, begin: float, end: float) -> float:
    """Return in which cycle of a phase the gain is first halfway from one to the other."""
    gains = row["phases"][phase]["gain"]
    return next(i for i, gain in enumerate(gains, 1) if (gain - begin) / (end - begin) >= 0.5)


def kept(row: Row, frequency_Hz: float) -> float:
    """Return the change of the gain at a frequency, as a share of that at the one which was trained."""
    change = {f: settled(row, test("after", f)) - settled(row, test("before", f)) for f in (frequency_Hz, LEARNT_HZ)}
    return change[frequency_Hz] / change[LEARNT_HZ]


def slips(row: Row) -> tuple[float, float]:
    """Return the slip in the first cycle of learning, and its mean over the last ten."""
    values = row["phases"]["learning"]["slip_deg_s"]
    return values[0], fmean(values[-10:])


def figures(condition: str) -> Iterator[tuple[str, Callable[[Row], float], str]]:
    """Yield what is told of a condition: its name, how it is computed of a row, and how it is written."""
    wanted, _ = CONDITIONS[condition]
    learned = condition != "fixed"
    yield "gain before, in the dark", lambda row: settled(row, test("before", LEARNT_HZ)), ".2f"
    yield "gain after learning, in the dark", lambda row: settled(row, test("after", LEARNT_HZ)), ".2f"
    if learned:
        half = "cycles of 1 s until half of it is learned"
        yield half, lambda row: halfway(row, "learning", settled(row, test("before", LEARNT_HZ)), wanted), ".1f"
    yield "slip at first, deg/s (rms)", lambda row: slips(row)[0], ".1f"
    yield "slip in the end, deg/s (rms)", lambda row: slips(row)[1], ".1f"
    yield "by which factor it fell", lambda row: slips(row)[0] / slips(row)[1], ".1f"
    for frequency_Hz in TESTS_HZ:
        if learned and frequency_Hz != LEARNT_HZ:
            name = f"change of gain at {frequency_Hz:g} Hz, of that at 1 Hz"
            yield name, lambda row, f=frequency_Hz: kept(row, f), ".2f"  # type: ignore[misc]
    for frequency_Hz in TESTS_HZ:
        name = f"lead of the eye after learning, {frequency_Hz:g} Hz, deg"
        yield name, lambda row, f=frequency_Hz: settled(row, test("after", f), "phase_deg"), ".0f"  # type: ignore[misc]
    if condition not in CONTROLS:
        yield "gain after one minute more in the dark", lambda row: fmean(row["phases"]["dark"]["gain"][-10:]), ".2f"
        back = "cycles until half of the way back to 1"
        yield back, lambda row: halfway(row, "back", settled(row, "dark"), 1.0), ".1f"
        yield "gain after that, in the dark", lambda row: settled(row, "end"), ".2f"


def table(rows: Sequence[Row]) -> str:
    """Return all figures as a table: the mean over the seeds and, in brackets, the least and the largest."""
    cells: dict[str, dict[str, str]] = {}
    for condition in CONDITIONS:
        own = [row for row in rows if row["condition"] == condition]
        for name, compute, written in figures(condition):
            values = [compute(row) for row in own]
            least, mean, most = (f"{value:z{written}}" for value in (min(values), fmean(values), max(values)))
            cells.setdefault(name, {})[condition] = f"{mean} ({least} to {most})"
    lines = [f"| | {' | '.join(CONDITIONS)} |", "| --- |" + " --- |" * len(CONDITIONS)]
    lines += [f"| {name} | {' | '.join(of.get(each, '') for each in CONDITIONS)} |" for name, of in cells.items()]
    return "\n".join(lines) + "\n"


def into_page(page: str, rows: Sequence[Row]) -> str:
    """Return the page with this table in the place of the one between its marks."""
    marks = r"(<!-- table: .*? -->\n\n).*?(\n<!-- end of table -->)"
    return re.sub(marks, lambda found: found[1] + table(rows) + found[2], page, flags=re.DOTALL)


COLOURS = {"up": "tab:red", "down": "tab:blue", "fixed": "tab:gray", "undelayed": "tab:orange"}
LABELS = {"up": "wanted 1.5", "down": "wanted 0.5", "fixed": "no plasticity", "undelayed": "no delayed mossy fibres"}


def draw(rows: Sequence[Row], file: Path) -> None:
    """Draw gain and slip over time, and the gain in the dark over the frequency; each seed is a line."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context(
        {
            "svg.hashsalt": file.stem,
            "svg.fonttype": "none",
            "font.size": 9,
            "axes.spines.top": False,
            "axes.spines.right": False,
        }
    ):
        figure = Figure(figsize=(9.0, 5.2), layout="constrained")
        grid = figure.add_gridspec(2, 2, width_ratios=(2.1, 1))
        gain = figure.add_subplot(grid[0, 0])
        slip = figure.add_subplot(grid[1, 0], sharex=gain)
        _over_time(rows, gain, slip)
        panels = [gain, slip, figure.add_subplot(grid[0, 1]), figure.add_subplot(grid[1, 1])]
        _over_frequency(rows, panels[2], ("up", "down", "undelayed"), "gain")
        _over_frequency(rows, panels[3], ("up", "down", "undelayed"), "phase_deg")
        for letter, panel in zip("abcd", panels, strict=True):
            panel.set_title(letter, loc="left", fontweight="bold")
        figure.savefig(file, metadata={"Date": None})


def _over_time(rows: Sequence[Row], gain: Any, slip: Any) -> None:
    phases = protocol("up")
    lengths_s = [phase["cycles"] / float(phase.get("frequency", "1 Hz").split()[0]) for phase in phases.values()]
    begins_s = dict(zip(phases, accumulate(lengths_s, initial=0.0), strict=False))
    shown = [name for name, phase in phases.items() if "frequency" not in phase]
    for condition in ("up", "down", "fixed"):
        for row in (row for row in rows if row["condition"] == condition):
            for panel, figure, names in ((gain, "gain", shown), (slip, "slip_deg_s", ("natural", "learning", "back"))):
                for name in (name for name in names if name in row["phases"]):
                    values = row["phases"][name][figure]
                    first = row["seed"] == 0 and name == "learning" and panel is gain
                    panel.plot(
                        [begins_s[name] + i + 0.5 for i in range(len(values))],
                        values,
                        color=COLOURS[condition],
                        linewidth=0.8,
                        label=LABELS[condition] if first else None,
                    )
    ends_s = {name: begins_s[name] + length for name, length in zip(phases, lengths_s, strict=True)}
    tested = [("before_250_mHz", "before_2000_mHz", "tests"), ("after_250_mHz", "after_2000_mHz", "tests")]
    for first, last, text in [*tested, ("dark", "dark", "dark")]:
        for panel in (gain, slip):
            panel.axvspan(begins_s[first], ends_s[last], color="0.9", linewidth=0)
        gain.text((begins_s[first] + ends_s[last]) / 2, 1.72, text, ha="center", va="top", color="0.35")
    for name, text in (("natural", "natural"), ("learning", "learning"), ("back", "back to 1")):
        gain.text((begins_s[name] + ends_s[name]) / 2, 1.72, text, ha="center", va="top")
    for wanted in (0.5, 1.0, 1.5):
        gain.axhline(wanted, color="0.7", linewidth=0.6, linestyle=":", zorder=0)
    gain.set(ylabel="gain of the reflex, 1 Hz", ylim=(0.3, 1.75), xlim=(0, ends_s["end"]))
    gain.tick_params(labelbottom=False)
    gain.legend(loc="center left", bbox_to_anchor=(0.42, 0.32), frameon=False)
    slip.set(ylabel="slip of the image, deg/s (rms)", xlabel="time, s", ylim=(0, None))


def _over_frequency(rows: Sequence[Row], panel: Any, conditions: Sequence[str], figure: str) -> None:
    frequencies_Hz = list(TESTS_HZ)
    for row in rows:
        if row["condition"] in conditions:
            values = [settled(row, test("after", f), figure) for f in frequencies_Hz]
            colour = COLOURS[row["condition"]]
            label = LABELS[row["condition"]] if row["seed"] == 0 else None
            panel.plot(frequencies_Hz, values, color=colour, marker=".", linewidth=0.8, label=label)
        if row["condition"] == "up":
            values = [settled(row, test("before", f), figure) for f in frequencies_Hz]
            label = "before learning" if row["seed"] == 0 else None
            panel.plot(frequencies_Hz, values, color="0.5", linestyle="--", marker=".", linewidth=0.8, label=label)
    panel.set_xscale("log")
    panel.set_xticks(frequencies_Hz, [f"{f:g}" for f in frequencies_Hz])
    panel.minorticks_off()
    panel.axvline(LEARNT_HZ, color="0.7", linewidth=0.6, linestyle=":", zorder=0)
    if figure == "gain":
        panel.set(ylabel="gain in the dark", ylim=(0.3, 2.3))
        panel.tick_params(labelbottom=False)
        panel.legend(loc="upper left", frameon=False, fontsize=8)
    else:
        panel.set(ylabel="lead of the eye, deg", xlabel="frequency of the test, Hz")


def main() -> int:
    """Measure, write and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5, help="how many networks, from seed 0 on")
    parser.add_argument("--fresh", action="store_true", help="measure also what has been measured")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    registry = Registry.discover()
    rows = json.loads(RESULT.read_text())["rows"] if RESULT.exists() and not arguments.fresh else []
    wanted = {
        (condition, seed): experiment(condition, seed, registry)
        for seed in range(arguments.seeds)
        for condition in CONDITIONS
    }
    hashes = {fingerprint(prepared): key for key, prepared in wanted.items()}
    done = {hashes[row["said_sha256"]]: row for row in rows if row["said_sha256"] in hashes}
    for (condition, seed), prepared in wanted.items():
        if (condition, seed) not in done:
            done[condition, seed] = measure(condition, seed, prepared)
        row = done[condition, seed]
        RESULT.write_text(
            json.dumps({"machine": machine(), "rows": [done[key] for key in wanted if key in done]}) + "\n"
        )
        gains = [round(settled(row, test(when, LEARNT_HZ)), 3) for when in ("before", "after")]
        print(f"{condition} {seed}: gain {gains[0]} -> {gains[1]}", flush=True)
    rows = json.loads(RESULT.read_text())["rows"]
    draw(rows, FIGURE)
    PAGE.write_text(into_page(PAGE.read_text(), rows))
    print(table(rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
