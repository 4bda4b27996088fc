"""Running an experiment: brain, body and recorders, into a run folder."""

import hashlib
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from neurorobo.config.document import dump
from neurorobo.config.experiment import Experiment
from neurorobo.engine import engine_path
from neurorobo.errors import NeuroroboError
from neurorobo.experiment.build import build_brain, build_task, untrained
from neurorobo.experiment.closed_loop import LARGEST_BATCH, EpisodeResult, in_batches, run_episodes
from neurorobo.experiment.memory import Memory
from neurorobo.experiment.plan import build_plan
from neurorobo.experiment.recorder import Recorder, Setting
from neurorobo.experiment.run_folder import RunFolder, new_folder_path
from neurorobo.experiment.summary import summarise
from neurorobo.experiment.weights import weights_file
from neurorobo.files import writing
from neurorobo.graph.plan import Plan
from neurorobo.plugins import Registry
from neurorobo.plugins.imports import described
from neurorobo.tasks.task import Task

SEEDS_NOTE = "# The seeds of the episodes are in run.json; `seed` is the file's, which draws untrained weights.\n"


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
    in_a_row: bool = False,
    arm: bool = False,
    dry_run: bool = False,
    record: Sequence[str] | None = None,
    command: str | None = None,
    progress: Callable[[int, int], None] = lambda tick, running: None,
) -> FinishedRun:
    """Run one episode per seed and write a run folder.

    Episodes run side by side and know nothing of one another; ``in_a_row``, one follows the other, and regions that
    learn as they run go on from what they have learned. A real body moves only with ``arm``; with ``dry_run`` it shows
    what it would be sent.
    ``record`` replaces the recorders that the file names; ``command`` is what was typed, for ``run.json``;
    ``progress`` is told each tick and how many still run. An interrupted run keeps what was recorded, and the
    KeyboardInterrupt says where; its ``run.json`` says ``interrupted``. Raises ConfigError for what cannot be built,
    NeuroroboError for what cannot be written.
    """
    engine_path()  # the environment may ask for what there is not; only what can be run gets a folder
    plan = build_plan(experiment)
    brain = build_brain(experiment, plan)
    for name in untrained(experiment, plan):
        print(f"note: the region `{name}` has no `weights`; it runs with fresh ones", file=sys.stderr)
    task = build_task(experiment)
    recorder_types = [registry.get("recorder", name) for name in (experiment.record if record is None else record)]
    path = out or new_folder_path(Path("runs"), experiment.name, experiment.config_hash)
    folder = RunFolder.create(
        path,
        given=experiment.document.text,
        resolved=SEEDS_NOTE + dump(_resolved(experiment)),
        seeds=seeds,
        command=command,
        weights=_fingerprints(experiment, plan),
        plugins={plugin.name: plugin.version for plugin in registry.plugins() if plugin.status == "loaded"},
    )
    recorders: list[Recorder] = []
    files: list[Path] = []
    try:
        if task is not None and (arm or dry_run):
            task.body.arm(dry_run=dry_run)
        registry.call("neurorobo_run_started", folder=path)
        setting = Setting(path, experiment.name, plan, seeds, task)
        for recorder_type in recorder_types:
            recorders.append(recorder_type(setting))
        results: list[EpisodeResult] = []
        memory, at_once = (Memory(), 1) if in_a_row else (None, _largest_batch(task))
        for batch in in_batches(seeds, at_once):
            results += run_episodes(
                brain,
                task,
                batch,
                duration_ns=None if experiment.episode is None else experiment.episode.duration,
                recorders=[r for r in recorders if not results or not r.most_neurons],
                memory=memory,
                progress=progress,
            )
        for result in results:
            if result.stopped is not None:
                print(f"note: the episode of seed {result.seed} was stopped: {result.stopped}", file=sys.stderr)
        summary = summarise(results, frozenset() if task is None else task.higher_is_better)
        folder.write_summary(summary)
        files += _finish(recorders, path)
        if task is not None:
            folder.write_timing(task.body.timing())
            task.body.close()  # which may move it out of harm's way, and fail
    except BaseException as error:
        try:
            files += _finish(recorders, path)
        except Exception as second:
            print(f"note: a recorder failed too: {described(second)}", file=sys.stderr)
        try:
            interrupted = isinstance(error, KeyboardInterrupt)
            folder.finish("interrupted" if interrupted else "failed", None if interrupted else described(error))
            if task is not None:
                folder.write_timing(task.body.timing())
        except NeuroroboError as second:  # the disk may be full, which must not hide the first error
            print(f"note: {second}", file=sys.stderr)
        if isinstance(error, KeyboardInterrupt):
            left = f"what was recorded until then is in {path}" if files else f"nothing was recorded yet, see {path}"
            stands = "" if task is None else task.body.standstill()
            raise KeyboardInterrupt(f"{stands}; {left}" if stands else left) from None
        raise
    finally:
        if task is not None:
            task.body.close()
    folder.finish("finished")
    registry.call("neurorobo_run_finished", folder=path, summary=summary)
    return FinishedRun(folder, summary, files)


def _largest_batch(task: Task[Any] | None) -> int:
    """Return how many episodes can run side by side."""
    most = None if task is None else task.body.largest_batch
    return LARGEST_BATCH if most is None else min(most, LARGEST_BATCH)


def _finish(recorders: list[Recorder], folder: Path) -> list[Path]:
    """Finish every recorder, each once, and return their files; raise the first error when all have been asked."""
    files, errors = [], []
    while recorders:
        recorder = recorders.pop(0)
        try:
            with writing(folder):
                file = recorder.finish()
        except Exception as error:
            errors.append(error)
        else:
            files += [] if file is None else [file]
    if errors:
        raise errors[0]
    return files


def _resolved(experiment: Experiment) -> dict[str, Any]:
    """Return the resolved experiment with paths that hold from any folder."""
    resolved = experiment.resolved()
    for name, config in experiment.regions.items():
        if config.weights not in (None, "pretrained"):
            resolved["regions"][name]["weights"] = str(weights_file(name, experiment))
    return resolved


def _fingerprints(experiment: Experiment, plan: Plan) -> dict[str, str]:
    """Return the SHA-256 of the weights file of each region in use, so that it can be known again."""
    used = {use.region: experiment.regions[use.region] for use in plan.uses()}
    files = {name: weights_file(name, experiment) for name, config in used.items() if config.weights}
    return {name: hashlib.sha256(file.read_bytes()).hexdigest() for name, file in files.items()}
