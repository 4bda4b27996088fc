"""The recording of a run: its first episode as a file for the rerun viewer."""

import importlib
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from neurorobo.bodies import Array
from neurorobo.experiment.recorder import Recorder, Sample, Setting
from neurorobo.graph.plan import Plan
from neurorobo.units import format_duration

if TYPE_CHECKING:
    import rerun
    from rerun.blueprint import Blueprint, TimeSeriesView, View

FILE = "recording.rrd"

TIMELINES = ("tick", "time")

MOST_NEURONS = 64
"""The most neurons of a layer in its raster; of a larger one, so many are shown, evenly spaced."""

LAYER_GAP = 4
"""Empty rows between the layers of one raster."""

PALETTE = (
    (86, 156, 236),
    (244, 151, 66),
    (109, 196, 112),
    (226, 102, 125),
    (176, 137, 228),
    (222, 203, 86),
    (88, 199, 199),
    (189, 160, 137),
)

Integers = NDArray[np.int64]


@dataclass(frozen=True)
class Signal:
    """A quantity over an episode: ``values`` (rows, width) in ``unit`` at ``ticks`` (rows,)."""

    ticks: Integers
    values: Array
    unit: str
    description: str = ""


@dataclass(frozen=True)
class Raster:
    """The spikes of a step over an episode: a picture of each window at ``ticks`` (windows,).

    ``pictures`` (windows, rows, steps) holds the layers one above the other, the first one lowest and its first neuron in the last
    row: i + 1 where a neuron of the i-th layer fired, else 0. ``neurons`` counts those of each layer, shown or not.
    """

    ticks: Integers
    pictures: NDArray[np.uint8]
    neurons: Mapping[str, int]


@dataclass(frozen=True)
class Episode:
    """One recorded episode.

    ``signals`` by path: ``body/<sensor>`` as read at the start of each tick and once more at the end of the last, ``command/<actuator>``
    as carried out, ``steps/<step>/<port>`` and ``rates/<step>/<layer>``, in spikes per neuron and step, whenever the step ran.
    ``rasters`` by step.
    """

    seed: int
    plan: Plan
    signals: Mapping[str, Signal]
    rasters: Mapping[str, Raster]

    def indexes(self, ticks: Integers) -> "list[rerun.TimeColumn]":
        """Return the times of rows, on both timelines: `tick` and `time`."""
        import rerun as rr

        time = (ticks * self.plan.clock.tick_ns).astype("timedelta64[ns]")
        return [rr.TimeColumn("tick", sequence=ticks), rr.TimeColumn("time", duration=time)]


class Scene(Protocol):
    """Draws a body in a recording; a task names the class of its scene in :attr:`~neurorobo.tasks.task.Task.scene`.

    ``legend`` explains the picture, in Markdown.
    """

    legend: str

    def __init__(self, setting: Setting) -> None:
        """Prepare to draw the body of ``setting.task``."""

    def log(self, stream: "rerun.RecordingStream", episode: Episode) -> None:
        """Log what stands still as static, and what moves in columns, at ``episode.indexes``."""

    def view(self) -> "View":
        """Return the view that shows it."""


class RerunRecorder(Recorder):
    """Writes ``recording.rrd``: the first episode, with the task's scene, every signal and the spike rasters of every step.

    Of a step that repeats within a tick, the last iteration is kept.
    """

    wants_spikes: ClassVar[bool] = True

    def __init__(self, setting: Setting) -> None:
        """Note the units, and build the task's scene."""
        super().__init__(setting)
        self._ended = False
        self._rows: defaultdict[str, list[tuple[int, Array]]] = defaultdict(list)
        self._pictures: defaultdict[str, list[tuple[int, NDArray[np.uint8]]]] = defaultdict(list)
        self._neurons: dict[str, dict[str, int]] = {}
        self._labels: dict[str, tuple[str, str]] = {}
        task = setting.task
        if task is not None:
            self._labels |= {f"body/{name}": (it.unit, it.description) for name, it in task.body.sensors.items()}
            self._labels |= {f"command/{name}": (it.unit, it.description) for name, it in task.body.actuators.items()}
        for use in setting.plan.uses():
            self._labels |= {f"steps/{use.name}/{name}": (port.unit, port.description) for name, port in use.outputs.items()}
        self._scene: Scene | None = None
        if task is not None and task.scene is not None:
            module, _, name = task.scene.partition(":")
            self._scene = getattr(importlib.import_module(module), name)(setting)

    def sample(self, sample: Sample) -> None:
        """Keep one tick of the first episode."""
        if self._ended:
            return
        self._keep("body", sample.tick, sample.observation)
        if not sample.running[0]:  # other episodes go on: this was what the first one ended with
            self._ended = True
            return
        self._keep("command", sample.tick, sample.given)
        for step, outputs in sample.outputs.items():
            self._keep(f"steps/{step}", sample.tick, {name: value.numpy() for name, value in outputs.items()})
        for step, layers in sample.spikes.items():
            first = {layer: spikes[:, 0].numpy() for layer, spikes in layers.items()}
            self._neurons[step] = {layer: spikes.shape[1] for layer, spikes in first.items()}
            self._pictures[step].append((sample.tick, _picture([*first.values()])))
            self._keep(f"rates/{step}", sample.tick, {layer: spikes.mean(keepdims=True) for layer, spikes in first.items()})
        task = self.setting.task
        if task is not None and not (sample.running & ~task.terminated() & ~task.truncated()).any():
            # No sample will follow. Only now, as reading a noisy sensor must not disturb an episode.
            self._keep("body", sample.tick + 1, task.body.read())
            self._ended = True

    def finish(self) -> Path | None:
        """Write the recording."""
        if not self._rows:
            return None
        import rerun as rr

        name, seed, plan = self.setting.name, self.setting.seeds[0], self.setting.plan
        episode = Episode(seed, plan, dict(self._signals()), dict(self._rasters()))
        path = self.setting.folder / FILE
        # The viewer remembers a changed layout by this name, so every experiment has its own.
        stream = rr.RecordingStream(f"neurorobo {name}")
        stream.save(path, default_blueprint=_blueprint(episode, self._scene))
        stream.send_recording_name(f"{name}, seed {seed}")
        clock = plan.clock
        times = {"tick_ns": clock.tick_ns, "spike_step_ns": clock.spike_step_ns, "window": clock.window}
        stream.send_property("experiment", rr.AnyValues(name=name, seed=seed, **times))
        _log_signals(stream, episode)
        _log_rasters(stream, episode)
        stream.log("about", rr.TextDocument(_about(name, episode, self._scene), media_type="text/markdown"), static=True)
        if self._scene is not None:
            self._scene.log(stream, episode)
        stream.flush()
        stream.disconnect()
        return path

    def _keep(self, group: str, tick: int, values: Mapping[str, Array]) -> None:
        for name, value in values.items():
            self._rows[f"{group}/{name}"].append((tick, np.array(value[0], dtype=np.float64)))

    def _signals(self) -> Iterator[tuple[str, Signal]]:
        for path, rows in self._rows.items():
            ticks, values = zip(*rows, strict=True)
            yield path, Signal(np.array(ticks), np.stack(values), *self._labels.get(path, ("1", "")))

    def _rasters(self) -> Iterator[tuple[str, Raster]]:
        for step, windows in self._pictures.items():
            ticks, pictures = zip(*windows, strict=True)
            yield step, Raster(np.array(ticks), np.stack(pictures), self._neurons[step])


def _picture(layers: Sequence[NDArray[np.float32]]) -> NDArray[np.uint8]:
    """Return the picture (rows, steps) of a window of ``layers`` (steps, neurons)."""
    rows: list[NDArray[np.uint8]] = []
    for i, spikes in enumerate(layers):
        if i:
            rows.append(np.zeros((LAYER_GAP, len(spikes)), dtype=np.uint8))
        shown = np.linspace(0, spikes.shape[1] - 1, min(MOST_NEURONS, spikes.shape[1])).round().astype(np.int64)
        rows.append(((i + 1) * (spikes.T[shown] != 0)).astype(np.uint8))
    return np.concatenate(rows)[::-1]


def _log_signals(stream: "rerun.RecordingStream", episode: Episode) -> None:
    import rerun as rr

    for paths in _plots(episode).values():
        taken = 0  # colours, within this plot
        for path in paths:
            signal = episode.signals[path]
            name, width = path.rpartition("/")[2], signal.values.shape[1]
            names = [f"{name}{f'.{i}' if width > 1 else ''} [{signal.unit}]" for i in range(width)]
            colors = [PALETTE[(taken + i) % len(PALETTE)] for i in range(width)]
            taken += width
            mode = "Linear" if path.startswith("body/") else "StepAfter"
            stream.log(path, rr.SeriesLines(names=names, colors=colors, widths=1.5, interpolation_mode=mode), static=True)
            columns = rr.Scalars.columns(scalars=signal.values.ravel())
            stream.send_columns(path, episode.indexes(signal.ticks), columns.partition([width] * len(signal.ticks)))


def _log_rasters(stream: "rerun.RecordingStream", episode: Episode) -> None:
    import rerun as rr

    for step, raster in episode.rasters.items():
        path = f"spikes/{step}"
        # With this range, the colour map begins with a background of its own.
        stream.log(path, rr.Tensor.from_fields(value_range=(0, len(raster.neurons) + 1)), static=True)
        pictures = [rr.datatypes.TensorData(array=picture, dim_names=("neuron", "step")) for picture in raster.pictures]
        stream.send_columns(path, episode.indexes(raster.ticks), rr.Tensor.columns(data=pictures))


def _plots(episode: Episode) -> dict[str, list[str]]:
    """Return the paths that share a plot, by its title: each quantity of the body has its own, a step has one for each unit."""
    plots: defaultdict[str, list[str]] = defaultdict(list)
    for path, signal in episode.signals.items():
        group, name = path.split("/", 1)
        if group == "steps":
            title = name.split("/")[0]
        else:
            title = f"{group}.{name}" + (f": {signal.description.rstrip('.')}" if signal.description else "")
        plots[f"{title} [{signal.unit}]"].append(path)
    return dict(plots)


def _about(name: str, episode: Episode, scene: Scene | None) -> str:
    """Explain the recording, in Markdown."""
    clock = episode.plan.clock
    text = f"# {name}, seed {episode.seed}\n"
    if scene is not None:
        text += scene.legend
    text += f"\n**Plots**: a tick lasts {format_duration(clock.tick_ns)}; sensors are read when it begins, commands hold until it ends.\n"
    if episode.rasters:
        text += (
            f"\n**Spikes**: each dot is one, each row a neuron, each colour a layer; of a large layer, {MOST_NEURONS} neurons are shown. "
            f"The window of {clock.window} steps of {format_duration(clock.spike_step_ns)} lies at the start of its tick: zoom in, or choose "
            "the timeline `spike_step` below, on which all windows stand side by side. Of a step that repeats, this is the last iteration.\n"
        )
    return text


def _blueprint(episode: Episode, scene: Scene | None) -> "Blueprint":
    """Lay out the scene on the left, the body's signals and the spikes beside it, and the signals of all steps on a second tab."""
    import rerun as rr
    import rerun.blueprint as rrb
    from rerun.blueprint.components import LinkAxis

    regions = {use.name: use.region for use in episode.plan.uses()}
    axis = rrb.TimeAxis(link=LinkAxis.LinkToGlobal)

    def plot(title: str, paths: Sequence[str]) -> "TimeSeriesView":
        several = len(paths) > 1 or episode.signals[paths[0]].values.shape[1] > 1
        return rrb.TimeSeriesView(
            name=title, contents=[f"+ /{path}" for path in paths], axis_x=axis, plot_legend=rrb.PlotLegend(visible=several)
        )

    def raster(step: str, layers: Mapping[str, Raster]) -> "TimeSeriesView":
        names = ", ".join(f"{layer} ({it.neurons})" for layer, it in layers.items())
        return rrb.TimeSeriesView(
            name=f"{step} by {regions[step]}, from below: {names}",
            origin=rr.new_entity_path(["spikes", step]),
            axis_x=axis,
            plot_legend=rrb.PlotLegend(visible=False),
        )

    plots = _plots(episode)
    body = [plot(title, paths) for title, paths in plots.items() if not paths[0].startswith("steps/")]
    steps = [plot(title, paths) for title, paths in plots.items() if paths[0].startswith("steps/")]
    spikes = [raster(step, layers) for step, layers in episode.rasters.items()]
    about = rrb.TextDocumentView(origin="/about", name="About")
    left = about if scene is None else rrb.Vertical(scene.view(), about, row_shares=[5, 2])
    columns = [rrb.Vertical(*views) for views in (body or steps, spikes) if views]
    overview = rrb.Horizontal(left, *columns, name="Overview")
    return rrb.Blueprint(
        rrb.Tabs(overview, rrb.Grid(*steps, name="Steps"), active_tab=0) if body and steps else overview,
        rrb.TimePanel(timeline="time", state="collapsed", play_state="playing", loop_mode="all"),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
    )
