"""Turns trained weights into shipped ones: fixed point, named by their configuration, each with a model card.

After ``neurorobo train examples/peg_in_hole.yaml`` run
``python plugins/precision_interaction/tools/ship.py examples/peg_in_hole.yaml runs/peg_in_hole/training-<hash>``. The
card says how each phase trained, in full, and how far the region is from its teacher: the shipped file is written, read
back, and compared on fresh data.
"""

import argparse
import json
import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch

from neurorobo.config.document import dump
from neurorobo.config.experiment import Experiment, load_experiment
from neurorobo.errors import NeuroroboError
from neurorobo.experiment.build import build, build_region
from neurorobo.experiment.lessons import Lesson, read_lessons
from neurorobo.learning.evaluate import evaluate
from neurorobo.learning.phase import SupervisePhase
from neurorobo.plugins import Registry
from neurorobo.regions.region import Region
from neurorobo.regions.weights import GRID_BITS, load_weights, save_weights
from neurorobo.regions.weights_file import signature_hash

WEIGHTS = Path(__file__).resolve().parents[1] / "precision_interaction" / "weights"
LARGE = 1_000_000
EXACT_BITS = 22  # of the 24 that a float32 has


def ship(
    experiment: Experiment, name: str, lessons: Sequence[Lesson], trained: Path, report: Mapping[str, Any], out: Path
) -> Path:
    """Write the weights and the card of one region into the folder ``out``; return the weights file.

    Raises a NeuroroboError if the folder ``trained`` holds a phase that was trained by other settings than the file's.
    """
    config = experiment.regions[name]
    region = build_region(config, experiment, torch.Generator().manual_seed(0))
    phases = [phase for phase in report["phases"] if name in phase["regions"]]
    for lesson, phase in zip(lessons, phases, strict=True):
        _same_settings(region, lesson, trained / f"phase{phase['index']}_{name}.safetensors")
    notes = load_weights(region, trained / f"{name}.safetensors")
    stem = f"{config.type.rpartition('.')[2]}-{signature_hash(config, experiment.clock)}"
    path = out / f"{stem}.safetensors"
    periods = ", ".join(f"{period} {ns / 1e6:g} ms" for period, ns in experiment.clock.periods_ns.items())
    purpose = f"{experiment.name}, periods {periods}"
    save_weights(region, path, {"for": purpose}, bits={n: fractional_bits(w) for n, w in region.named_parameters()})
    load_weights(region, path)
    trained_by = f"configuration {notes.get('experiment', experiment.config_hash)}"
    lines = [f"# {stem}", "", f"Trained for {purpose}; {trained_by}.", ""]
    taught_last = {output: lesson for lesson in lessons for output in _phase(lesson).loss}
    for lesson, phase in zip(lessons, phases, strict=True):
        final = [output for output in _phase(lesson).loss if taught_last[output] is lesson]
        lines += _section(lesson, phase, _shipped(region, experiment, lesson, phase["seed"], final))
    lines += ["## Configuration", "", "```yaml", dump(dict(config.signature(experiment.clock))).rstrip(), "```", ""]
    path.with_suffix(".md").write_text("\n".join(lines), encoding="utf-8")
    return path


def _phase(lesson: Lesson) -> SupervisePhase:
    assert isinstance(lesson.phase, SupervisePhase), "only supervised phases can be shipped"
    return lesson.phase


def _same_settings(region: Region, lesson: Lesson, file: Path) -> None:
    wanted = json.dumps(lesson.phase.model_dump(mode="json"), sort_keys=True)
    if load_weights(region, file).get("phase_config", wanted) != wanted:
        raise NeuroroboError(f"{file} was trained by other settings than the file says now; give those of the training")


def _shipped(
    region: Region, experiment: Experiment, lesson: Lesson, seed: int, outputs: Sequence[str]
) -> Mapping[str, Any]:
    """Compare the shipped region with its teacher on these outputs, on other draws than those of the training."""
    if not outputs:
        return {}
    teacher = build_region(lesson.teacher, experiment, torch.Generator())
    data = build(lesson.data, experiment.clock)
    examiner = torch.Generator().manual_seed(seed + 1_000_003)
    found = evaluate(region, teacher, data, examiner, outputs=outputs, unroll=_phase(lesson).unroll, batches=32)
    return found.to_json()


def fractional_bits(weight: torch.Tensor) -> int:
    """Return the fractional bits of a tensor: as many as leave it 16 bits in all, or 8 if it is large, but at most 16.

    They are also so few that the sums over a neuron's sources stay exact in float32, with room for other projections. A
    coarse grid is not harmless: multiples of 2**-10 shifted the prefrontal cortex by several um/s at some states.
    """
    weight = weight.detach().abs()
    largest = float(weight.max()) if weight.numel() else 0.0
    if largest == 0.0:
        return GRID_BITS
    in_all = math.floor(math.log2((127 if weight.numel() >= LARGE else 32767) / largest))
    exact = EXACT_BITS - math.ceil(math.log2(float(weight.sum(-1).max())))
    return min(16, in_all, exact)


def _section(lesson: Lesson, phase: Mapping[str, Any], shipped: Mapping[str, Any]) -> list[str]:
    """Return the card's lines on one training phase; *as shipped* stands only where no later phase taught on."""
    settings = lesson.phase.model_dump(mode="json", exclude_none=True)
    settings |= {key: part.model_dump(mode="json", exclude_none=True) for key, part in lesson.parts.items()}
    lines = [
        f"## Phase {phase['index']}: {', '.join(_phase(lesson).loss)}",
        "",
        f"It took {phase['seconds'] / 60:.1f} minutes.",
        "",
        "```yaml",
        dump(settings).rstrip(),
        "```",
        "",
        "| output | window | rms error as trained | largest | bias | rms error as shipped | largest | bias |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    trained = phase["evaluation"]
    for output, windows in trained["rms"].items():
        for window in range(len(windows)):
            cells = [_cell(found, output, window) for found in (trained, shipped)]
            lines.append(f"| {output} | {window + 1} | {' | '.join(cells)} |")
    rates = ", ".join(f"{layer} {rate:.2f}" for layer, rate in (shipped or trained)["firing_rates"].items())
    return [*lines, "", f"Firing rates as {'shipped' if shipped else 'trained'}: {rates}.", ""]


def _cell(found: Mapping[str, Any], output: str, window: int) -> str:
    """Return rms error, largest error and bias of an output in one window, or empty cells if it was not compared."""
    if output not in found.get("rms", {}):
        return " | | "
    return " | ".join(
        ", ".join(f"{value:.3g}" for value in found[table][output][window]) for table in ("rms", "largest", "bias")
    )


def main() -> None:
    """Ship the regions that were trained."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    parser.add_argument("trained", type=Path)
    parser.add_argument("--set", action="append", default=[], dest="overrides")
    parser.add_argument("--out", type=Path, default=WEIGHTS, help="by default the plugin's weights")
    arguments = parser.parse_args()
    registry = Registry.discover()
    try:
        experiment = load_experiment(arguments.file, arguments.overrides, registry)
        lessons = read_lessons(experiment, registry)
        report = json.loads((arguments.trained / "training.json").read_text())
        for name in dict.fromkeys(name for phase in report["phases"] for name in phase["regions"]):
            own = [lesson for lesson in lessons if name in lesson.phase.pupils]
            path = ship(experiment, name, own, arguments.trained, report, arguments.out)
            print(f"{path.name}: {path.stat().st_size / 1e6:.2f} MB")
    except (NeuroroboError, OSError) as error:
        sys.exit(f"error: {error}")


if __name__ == "__main__":
    main()
