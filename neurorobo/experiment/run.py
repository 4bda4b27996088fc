"""Running an experiment: brain, body and recorders, into a run folder."""

import hashlib
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from neurorobo.config.document import dump
from neurorobo.config.experiment import Experiment
from neurorobo.experiment.build import build_brain, build_task, untrained, weights_file
from neurorobo.experiment.closed_loop import run_episodes
from neurorobo.experiment.plan import build_plan
from neurorobo.experiment.recorder import Recorder, Setting
from neurorobo.experiment.run_folder import RunFolder, new_folder_path
from neurorobo.experiment.summary import summarise
from neurorobo.plugins import Registry

LARGEST_BATCH = 100
"""Episodes run side by side; more of them follow in further batches, to bound the memory."""


@dataclass(frozen=True)
class FinishedRun:
    """What a run left behind: its folder, its summary, and the files of its recorders."""

    folder: RunFolder
    summary: dict[str, Any]
    files: Sequence[Path]


def run_experiment(
    experiment: Experiment,
    registry: Registry,
    seeds: Sequence[int],
    out: Path | None = None,
    *,
    record: Sequence[str] | None = None,
    progress: Callable[[int, int], None] = lambda tick, running: None,
) -> FinishedRun:
    """Run one episode per seed and write a run folder.

    ``record`` replaces the recorders that the file names; ``progress`` is told each tick and how many still run. An
    interrupted run keeps what was recorded; its ``run.json`` says ``interrupted``.
    """
    import torch

    # A second thread gains little in a control loop, and a busy neighbour turns it into a loss.
    torch.set_num_threads(1)
    plan = build_plan(experiment)
    brain = build_brain(experiment, plan)
    for name in untrained(experiment):
        print(f"note: the region `{name}` has no `weights`; it runs with fresh ones", file=sys.stderr)
    task = build_task(experiment)
    path = out or new_folder_path(Path("runs"), experiment.name, experiment.config_hash)
    folder = RunFolder.create(
        path,
        given=experiment.document.text,
        resolved=dump(_resolved(experiment)),
        seeds=seeds,
        weights=_fingerprints(experiment),
        plugins={plugin.name: plugin.version for plugin in registry.plugins() if plugin.status == "loaded"},
    )
    registry.call("neurorobo_run_started", folder=path)
    setting = Setting(path, experiment.name, plan, seeds[:LARGEST_BATCH], task)
    names = experiment.record if record is None else record
    recorders: list[Recorder] = [registry.get("recorder", name)(setting) for name in names]
    results = []
    try:
        for start in range(0, len(seeds), LARGEST_BATCH):
            batch = seeds[start : start + LARGEST_BATCH]
            results += run_episodes(
                brain,
                task,
                batch,
                duration_ns=None if experiment.episode is None else experiment.episode.duration,
                recorders=recorders if start == 0 else (),
                progress=progress,
            )
    except BaseException as error:
        for recorder in recorders:
            recorder.finish()
        folder.finish("interrupted" if isinstance(error, KeyboardInterrupt) else "failed")
        raise
    files = [file for recorder in recorders if (file := recorder.finish()) is not None]
    summary = summarise(results, frozenset() if task is None else task.higher_is_better)
    folder.write_summary(summary)
    folder.finish("finished")
    registry.call("neurorobo_run_finished", folder=path, summary=summary)
    return FinishedRun(folder, summary, files)


def _resolved(experiment: Experiment) -> dict[str, Any]:
    """Return the resolved experiment with paths that hold from any folder."""
    resolved = experiment.resolved()
    for name, config in experiment.regions.items():
        if config.weights not in (None, "pretrained"):
            resolved["regions"][name]["weights"] = str(weights_file(config, experiment))
    return resolved


def _fingerprints(experiment: Experiment) -> dict[str, str]:
    """Return the SHA-256 of each region's weights file, so that it can be known again."""
    files = {n: weights_file(config, experiment) for n, config in experiment.regions.items() if config.weights}
    return {name: hashlib.sha256(file.read_bytes()).hexdigest() for name, file in files.items()}
