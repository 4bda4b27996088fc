"""Turns trained weights into shipped ones: fixed point, named by their configuration, each with a model card.

After ``neurorobo train examples/peg_in_hole.yaml`` run
``python benchmarks/training/ship.py examples/peg_in_hole.yaml runs/peg_in_hole/training-<hash>``. The card's figures
are those of the file as it is shipped: it is written, read back, and compared with its teacher on fresh data.
"""

import argparse
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from neurorobo.config.document import dump
from neurorobo.config.experiment import Experiment, load_experiment
from neurorobo.experiment.build import build, build_region
from neurorobo.experiment.lessons import Lesson, read_lessons
from neurorobo.learning.evaluate import evaluate
from neurorobo.plugins import Registry
from neurorobo.regions.weights import GRID_BITS, load_weights, save_weights, signature_hash

WEIGHTS = Path(__file__).resolve().parents[2] / "plugins/precision_interaction/precision_interaction/weights"
LARGE = 1_000_000


def ship(experiment: Experiment, name: str, lessons: list[Lesson], trained: Path, report: Mapping[str, Any]) -> Path:
    """Write the weights and the card of one region."""
    config = experiment.regions[name]
    region = build_region(config, experiment, torch.Generator().manual_seed(0))
    load_weights(region, trained / f"{name}.safetensors")
    stem = f"{config.type.rpartition('.')[2]}-{signature_hash(config, experiment.clock)}"
    path = WEIGHTS / f"{stem}.safetensors"
    periods = ", ".join(f"{period} {ns / 1e6:g} ms" for period, ns in experiment.clock.periods_ns.items())
    purpose = f"{experiment.name}, periods {periods}"
    save_weights(region, path, {"for": purpose}, bits={n: _bits(w) for n, w in region.named_parameters()})
    load_weights(region, path)
    phases = [phase for phase in report["phases"] if phase["region"] == name]
    lines = [f"# {stem}", "", f"Trained for {purpose}.", ""]
    for lesson, phase in zip(lessons, phases, strict=True):
        teacher = build_region(lesson.teacher, experiment, torch.Generator())
        data = build(lesson.data, experiment.clock)
        examiner = torch.Generator().manual_seed(phase["seed"] + 1_000_003)
        shipped = evaluate(
            region, teacher, data, examiner, outputs=lesson.phase.loss, unroll=lesson.phase.unroll, batches=32
        )
        lines += _section(lesson, phase, shipped.to_json())
    lines += ["## Configuration", "", "```yaml", dump(dict(config.signature(experiment.clock))).rstrip(), "```", ""]
    path.with_suffix(".md").write_text("\n".join(lines), encoding="utf-8")
    return path


def _bits(weight: torch.Tensor) -> int:
    """Return the fractional bits of a tensor: 10, or for a large one what lets it fit 8 bits in all."""
    if weight.numel() < LARGE:
        return GRID_BITS
    return min(GRID_BITS, math.floor(math.log2(127 / float(weight.detach().abs().max()))))


def _section(lesson: Lesson, phase: Mapping[str, Any], shipped: Mapping[str, Any]) -> list[str]:
    """Return the card's lines on one training phase."""
    lines = [
        f"## Phase {phase['index']}: {', '.join(lesson.phase.loss)}",
        "",
        f"Taught by `{lesson.teacher.type}` on `{lesson.data.type}`, {lesson.phase.steps} steps of "
        f"{lesson.phase.batch}, seed {phase['seed']}, {phase['seconds'] / 60:.1f} minutes.",
        "",
        "| output | window | rms error as trained | as shipped | largest | bias |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for output, windows in shipped["rms"].items():
        for window, values in enumerate(windows):
            cells = [phase["evaluation"]["rms"][output][window], values]
            cells += [shipped[table][output][window] for table in ("largest", "bias")]
            shown = " | ".join(", ".join(f"{value:.3g}" for value in cell) for cell in cells)
            lines.append(f"| {output} | {window + 1} | {shown} |")
    rates = ", ".join(f"{layer} {rate:.2f}" for layer, rate in shipped["firing_rates"].items())
    return [*lines, "", f"Firing rates: {rates}.", ""]


def main() -> None:
    """Ship the regions that were trained."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    parser.add_argument("trained", type=Path)
    parser.add_argument("--set", action="append", default=[], dest="overrides")
    arguments = parser.parse_args()
    registry = Registry.discover()
    experiment = load_experiment(arguments.file, arguments.overrides, registry)
    lessons = read_lessons(experiment, registry)
    report = json.loads((arguments.trained / "training.json").read_text())
    for name in dict.fromkeys(phase["region"] for phase in report["phases"]):
        own = [lesson for lesson in lessons if lesson.phase.region == name]
        path = ship(experiment, name, own, arguments.trained, report)
        print(f"{path.name}: {path.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
