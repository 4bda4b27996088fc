"""How far the prefrontal cortex is from its teacher: over the whole range of every input, and on its own way.

Run ``python benchmarks/assembly/planner_accuracy.py`` (a minute or two). *Uniform* draws every input evenly from the
range of what occurs, the distance left evenly from each bin; *on policy* are the situations that the brain meets in
insertions over the seeds from 1000 on. The command writes ``benchmarks/assembly/planner_accuracy.json``, prints the
table of the speed, and exits with 1 if it errs by more than is wanted.
"""

import argparse
import hashlib
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from precision_interaction.data.planning_states import PlanningStatesConfig
from torch import Tensor

from neurorobo.config.experiment import Experiment, load_experiment
from neurorobo.experiment.build import build_brain, build_region, build_task
from neurorobo.experiment.closed_loop import run_episodes
from neurorobo.experiment.lessons import read_lessons
from neurorobo.experiment.recorder import Recorder, Sample, Setting
from neurorobo.experiment.weights import weights_file
from neurorobo.graph.brain import Brain
from neurorobo.learning.phase import SupervisePhase
from neurorobo.plugins import Registry
from neurorobo.regions.region import Region
from neurorobo.units import Interval

ROOT = Path(__file__).resolve().parents[2]
LATEST = Path(__file__).with_name("planner_accuracy.json")
REGION = "prefrontal_cortex"
OUTPUTS = ("speed", "beta", "confidence", "terminal")
BINS_UM = ((0, 10), (10, 50), (50, 150), (150, 300), (300, 450), (450, 1000), (1000, 2050))
CHUNK = 250

WANTED_SPEED_ERROR_UM_S = {"uniform": 12.0, "on policy": 8.0}
"""Nine of ten errors of the planned speed are to be smaller than this, in every bin of the distance left."""

Values = Mapping[str, Tensor]


def teachers(experiment: Experiment) -> dict[str, Region]:
    """Return, for each output, the teacher that taught it last."""
    lessons = [lesson for lesson in read_lessons(experiment, Registry.discover()) if REGION in lesson.phase.pupils]
    last = {
        output: lesson.teacher
        for lesson in lessons
        if isinstance(lesson.phase, SupervisePhase)
        for output in lesson.phase.loss
    }
    return {output: build_region(last[output], experiment, torch.Generator()) for output in OUTPUTS}


def uniform(region: Region, states: int, generator: torch.Generator) -> dict[str, Tensor]:
    """Draw ``states`` situations per bin of the distance left, (states * bins, width) of each input.

    The last speed and beta are such as can be planned, the variance such as is taught; their codes reach beyond.
    """
    batch = states * len(BINS_UM)
    occurring = {
        **{name: region.output_ports[name].code for name in ("speed", "beta")},
        "variance": Interval(0.0, PlanningStatesConfig().largest_variance),
    }
    values = {}
    for name, port in region.input_ports.items():
        limits = occurring.get(name, port.code)
        assert limits is not None
        values[name] = limits.lo + (limits.hi - limits.lo) * torch.rand(batch, port.width, generator=generator)
    edges = torch.tensor(BINS_UM, dtype=torch.float32).repeat_interleave(states, dim=0)
    nearer, further = edges[:, :1], edges[:, 1:]
    return {**values, "remaining": nearer + (further - nearer) * torch.rand(batch, 1, generator=generator)}


class Situations(Recorder):
    """Keeps what the step `plan` was told in every running episode, and what it said."""

    def __init__(self, setting: Setting, region: Region) -> None:
        super().__init__(setting)
        self.first = {name: torch.tensor([region.input_ports[name].initial]) for name in ("speed", "beta")}
        self.before: Values | None = None
        self.told: list[Values] = []
        self.said: list[Values] = []

    def sample(self, sample: Sample) -> None:
        """Put together the inputs of the plan, as the example wires them; it runs once per control period."""
        if "plan" not in sample.outputs:
            return
        said = {name: sample.outputs["plan"][name].clone() for name in OUTPUTS}
        before = self.before or {name: value.expand(len(sample.running), -1) for name, value in self.first.items()}
        told = {
            "force": torch.as_tensor(sample.observation["force"], dtype=torch.float32),
            "forecast": sample.outputs["forecast"]["sum"],
            "variance": sample.outputs["remember"]["variance"],
            "remaining": torch.as_tensor(sample.observation["remaining"], dtype=torch.float32),
            "speed": before["speed"],
            "beta": before["beta"],
        }
        running = torch.from_numpy(sample.running)
        self.told.append({name: value[running] for name, value in told.items()})
        self.said.append({name: value[running] for name, value in said.items()})
        self.before = said

    def finish(self) -> None:
        """Nothing is written."""


def on_policy(experiment: Experiment, brain: Brain, seeds: Sequence[int]) -> tuple[Values, Values]:
    """Return what the plan was told, and said, in one insertion per seed."""
    task = build_task(experiment)
    situations = Situations(Setting(Path(), experiment.name, brain.plan, seeds, task), brain.region(REGION))
    run_episodes(brain, task, seeds, recorders=[situations])
    told, said = (
        {name: torch.cat([moment[name] for moment in moments]) for name in moments[0]}
        for moments in (situations.told, situations.said)
    )
    return told, said


@torch.no_grad()
def answers(region: Region, told: Values) -> dict[str, Tensor]:
    """Return what a region says to these inputs, as numbers (batch, width)."""
    found: dict[str, list[Tensor]] = {name: [] for name in OUTPUTS}
    for start in range(0, len(told["remaining"]), CHUNK):
        inputs = {}
        for name, port in region.input_ports.items():
            values = told[name][start : start + CHUNK]
            inputs[name] = values if port.code is None else port.code.encode(values, region.clock.window)
        said, _ = region.step(inputs, region.init_state(len(values)))
        for name, parts in found.items():
            code = region.output_ports[name].code
            parts.append(said[name] if code is None else code.decode(said[name]))
    return {name: torch.cat(parts) for name, parts in found.items()}


def compare(told: Values, said: Values, by_output: Mapping[str, Region]) -> dict[str, dict[str, Any]]:
    """Return the errors of each output in each bin of the distance left: bias, rms, quantiles and the largest."""
    wanted = {name: answers(teacher, told)[name] for name, teacher in by_output.items()}
    left_um = told["remaining"][:, 0]
    table: dict[str, dict[str, Any]] = {}
    for nearer, further in BINS_UM:
        here = (left_um >= nearer) & (left_um < further)
        if further == BINS_UM[-1][1]:
            here |= left_um >= further
        row: dict[str, Any] = {"states": int(here.sum())}
        for name in OUTPUTS:
            error = (said[name] - wanted[name])[here, 0]
            if not len(error):
                continue
            sizes = error.abs()
            row[name] = {
                "bias": float(error.mean()),
                "rms": float(error.square().mean().sqrt()),
                **{f"q{percent}": float(sizes.quantile(percent / 100)) for percent in (50, 90, 99)},
                "largest": float(sizes.max()),
            }
        table[f"{nearer}..{further} um"] = row
    return table


def measure(experiment: Experiment, *, states: int, seeds: Sequence[int]) -> dict[str, Any]:
    """Compare uniformly, with ``states`` situations per bin, and on policy over ``seeds``."""
    brain = build_brain(experiment)
    region, by_output = brain.region(REGION), teachers(experiment)
    everywhere = uniform(region, states, torch.Generator().manual_seed(1000))
    on_the_way, said = on_policy(experiment, brain, seeds)
    return {
        "uniform": compare(everywhere, answers(region, everywhere), by_output),
        "on policy": compare(on_the_way, said, by_output),
    }


def misses(measured: Mapping[str, Any]) -> list[str]:
    """Return in words where the speed errs by more than is wanted."""
    return [
        f"{where}, {left}: nine of ten errors of the speed are below {row['speed']['q90']:.1f} um/s, "
        f"wanted {WANTED_SPEED_ERROR_UM_S[where]:g}"
        for where, rows in measured.items()
        for left, row in rows.items()
        if "speed" in row and row["speed"]["q90"] > WANTED_SPEED_ERROR_UM_S[where]
    ]


def table(measured: Mapping[str, Any], output: str = "speed") -> str:
    """Return one output's errors as a Markdown table."""
    figures = ("bias", "rms", "q50", "q90", "q99", "largest")
    lines = [f"| {output}, distance left | states | {' | '.join(figures)} |", "| --- " * (2 + len(figures)) + "|"]
    for where, rows in measured.items():
        for left, row in rows.items():
            if output in row:
                cells = " | ".join(f"{row[output][name]:.3g}" for name in figures)
                lines.append(f"| {where}, {left} | {row['states']} | {cells} |")
    return "\n".join(lines)


def main() -> int:
    """Measure, write and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--states", type=int, default=2000, help="per bin of the distance left")
    parser.add_argument("--episodes", type=int, default=50)
    parser.add_argument("--out", type=Path, default=LATEST)
    arguments = parser.parse_args()
    experiment = load_experiment(ROOT / "examples" / "peg_in_hole.yaml")
    measured = measure(experiment, states=arguments.states, seeds=range(1000, 1000 + arguments.episodes))
    weights = weights_file(REGION, experiment)
    about = {
        "command": "python benchmarks/assembly/planner_accuracy.py",
        "config_hash": experiment.config_hash,
        "weights_sha256": hashlib.sha256(weights.read_bytes()).hexdigest(),
        "seeds": [1000, 999 + arguments.episodes],
    }
    arguments.out.write_text(json.dumps({**about, **measured}, indent=2) + "\n")
    for output in OUTPUTS:
        print(table(measured, output), end="\n\n")
    missed = misses(measured)
    print("\n".join(f"MISSED {miss}" for miss in missed))
    return int(bool(missed))


if __name__ == "__main__":
    sys.exit(main())
