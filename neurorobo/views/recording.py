"""The recording of a run: its first episode as a file for the rerun viewer."""

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Literal, Protocol

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from neurorobo.bodies import Array
from neurorobo.experiment.recorder import LayerSpikes, Recorder, Sample, Setting
from neurorobo.graph.plan import Plan
from neurorobo.plugins.imports import import_target
from neurorobo.units import format_duration

if TYPE_CHECKING:
    import rerun
    import rerun.blueprint

FILE = "recording.rrd"

TIMELINES = ("tick", "time")

MOST_NEURONS = 64
"""The most neurons of a layer in a raster; of a larger layer so many are shown, evenly spaced."""

LAYER_GAP = 4
"""Empty rows between the layers of a raster."""

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

Ticks = NDArray[np.int64]
Picture = NDArray[np.uint8]


@dataclass(frozen=True)
class Signal:
    """A quantity over an episode: ``values`` (rows, width) in ``unit`` at ``ticks`` (rows,)."""

    ticks: Ticks
    values: Array
    unit: str
    description: str = ""


@dataclass(frozen=True)
class Raster:
    """The spikes of a step over an episode, as a picture of each window at ``ticks`` (windows,).

    ``pictures`` (windows, rows, steps) hold i + 1 where a neuron of the i-th layer fired, else 0. The layers lie one
    above the other, the first one lowest and its first neuron in the last row. ``neurons`` counts those of each layer,
    shown or not.
    """

    ticks: Ticks
    pictures: Picture
    neurons: Mapping[str, int]


@dataclass(frozen=True)
class Episode:
    """One recorded episode: its signals by path, and its rasters by step.

    The paths are ``body/<sensor>``, read at the start of each tick and once more at the end of the last;
    ``command/<actuator>``, as carried out; ``steps/<step>/<port>`` and, in spikes per neuron and step,
    ``rates/<step>/<layer>``, whenever the step ran.
    """

    seed: int
    plan: Plan
    signals: Mapping[str, Signal]
    rasters: Mapping[str, Raster]

    def indexes(self, ticks: Ticks) -> "list[rerun.TimeColumn]":
        """Return the times of rows on all `TIMELINES`."""
        import rerun as rr

        time = (ticks * self.plan.clock.tick_ns).astype("timedelta64[ns]")
        return [rr.TimeColumn("tick", sequence=ticks), rr.TimeColumn("time", duration=time)]


class Scene(Protocol):
    """Draws a body in a recording; a task names its own in :attr:`~neurorobo.tasks.task.Task.scene`.

    ``legend`` explains the picture, in Markdown.
    """

    legend: str

    def __init__(self, setting: Setting) -> None:
        """Prepare to draw the body of ``setting.task``."""

    def log(self, stream: "rerun.RecordingStream", episode: Episode) -> None:
        """Log what stands still as static, and what moves in columns, at ``episode.indexes``."""

    def view(self) -> "rerun.blueprint.View":
        """Return the view that shows it."""


class RerunRecorder(Recorder):
    """Writes ``recording.rrd``: the first episode, with the task's scene, every signal and the spikes of every layer.

    Of a step that repeats within a tick, the last iteration is kept.
    """

    most_neurons: ClassVar[int] = MOST_NEURONS

    def __init__(self, setting: Setting) -> None:
        """Note the units, and build the task's scene."""
        super().__init__(setting)
        self._ended = False
        self._rows: defaultdict[str, list[tuple[int, Array | Tensor]]] = defaultdict(list)
        self._windows: defaultdict[str, list[tuple[int, Mapping[str, LayerSpikes]]]] = defaultdict(list)
        self._labels: dict[str, tuple[str, str]] = {}
        self._scene: Scene | None = None
        for use in setting.plan.uses():
            for name, port in use.outputs.items():
                self._labels[f"steps/{use.name}/{name}"] = port.unit, port.description
        task = setting.task
        if task is None:
            return
        for name, sensor in task.body.sensors.items():
            self._labels[f"body/{name}"] = sensor.unit, sensor.description
        for name, actuator in task.body.actuators.items():
            self._labels[f"command/{name}"] = actuator.unit, actuator.description
        self._labels["timing/latency"] = "ms", "From the sensors to the commands, by the wall clock."
        if task.scene is not None:
            self._scene = import_target(task.scene)(setting)

    def sample(self, sample: Sample) -> None:
        """Keep one tick of the first episode."""
        if self._ended:
            return
        self._keep("body", sample.tick, sample.observation)
        if not sample.running[0]:  # it has ended with this observation, while other episodes go on
            self._ended = True
            return
        self._keep("command", sample.tick, sample.given)
        if sample.latency_ms is not None:
            self._keep("timing", sample.tick, {"latency": np.array([[sample.latency_ms]])})
        for step, outputs in sample.outputs.items():
            for name, value in outputs.items():
                self._rows[f"steps/{step}/{name}"].append(
                    (sample.tick, value if value.shape[0] == 1 else value[:1].clone())
                )
        for step, layers in sample.spikes.items():
            self._windows[step].append((sample.tick, {layer: spikes.of_first() for layer, spikes in layers.items()}))
        task = self.setting.task
        if task is not None and not (sample.running & ~task.terminated() & ~task.truncated()).any():
            # No sample will follow. While one may, the body is not read: its noise must not depend on a recording.
            self._keep("body", sample.tick + 1, task.body.read())
            self._ended = True

    def finish(self) -> Path | None:
        """Write the recording."""
        if not self._rows and not self._windows:
            return None
        import rerun as rr

        name, plan, seed = self.setting.name, self.setting.plan, self.setting.seeds[0]
        clock = plan.clock
        episode = Episode(seed, plan, dict(self._signals()), dict(self._rasters()))
        path = self.setting.folder / FILE
        # The viewer remembers a changed layout by this name, so every experiment has its own.
        stream = rr.RecordingStream(f"neurorobo {name}")
        stream.save(path, default_blueprint=_blueprint(episode, self._scene))
        stream.send_recording_name(f"{name}, seed {seed}")
        stream.send_property(
            "experiment",
            rr.AnyValues(
                name=name, seed=seed, tick_ns=clock.tick_ns, spike_step_ns=clock.spike_step_ns, window=clock.window
            ),
        )
        about = _about(name, episode, self._scene)
        stream.log("about", rr.TextDocument(about, media_type="text/markdown"), static=True)
        _log_signals(stream, episode)
        _log_rasters(stream, episode)
        if self._scene is not None:
            self._scene.log(stream, episode)
        try:
            stream.flush()
        except RuntimeError as error:  # which is how rerun says that the disk is full
            raise OSError(str(error)) from error
        stream.disconnect()
        return path

    def _keep(self, group: str, tick: int, values: Mapping[str, Array]) -> None:
        for name, value in values.items():
            self._rows[f"{group}/{name}"].append((tick, value[:1].copy()))

    def _signals(self) -> Iterator[tuple[str, Signal]]:
        for path, rows in self._rows.items():
            ticks, values = zip(*rows, strict=True)
            arrays = [value.numpy() if isinstance(value, Tensor) else value for value in values]
            numbers = [np.array(array[0], dtype=np.float64, ndmin=1) for array in arrays]
            yield path, Signal(np.array(ticks), np.stack(numbers), *self._labels.get(path, ("1", "")))
        for step, kept in self._windows.items():
            ticks, windows = zip(*kept, strict=True)
            for layer in windows[-1]:
                rates = [float(layers[layer].rate) for layers in windows]
                yield f"rates/{step}/{layer}", Signal(np.array(ticks), np.array(rates)[:, None], "1")

    def _rasters(self) -> Iterator[tuple[str, Raster]]:
        for step, kept in self._windows.items():
            ticks, windows = zip(*kept, strict=True)
            neurons = {layer: spikes.neurons for layer, spikes in windows[-1].items()}
            pictures = [_picture([spikes.some[:, 0] for spikes in layers.values()]) for layers in windows]
            yield step, Raster(np.array(ticks), np.stack(pictures), neurons)


def _picture(layers: Sequence[NDArray[np.bool_]]) -> Picture:
    """Return the picture (rows, steps) of a window of ``layers`` (steps, neurons)."""
    rows: list[Picture] = []
    for i, spikes in enumerate(layers):
        if i:
            rows.append(np.zeros((LAYER_GAP, len(spikes)), dtype=np.uint8))
        rows.append(((i + 1) * spikes.T).astype(np.uint8))
    return np.concatenate(rows)[::-1]


def _entity(path: str) -> str:
    """Return a path in which rerun sees nothing special."""
    import rerun as rr

    return rr.new_entity_path(path.split("/"))


def _log_signals(stream: "rerun.RecordingStream", episode: Episode) -> None:
    import rerun as rr

    for paths in _plots(episode).values():
        color = 0
        for path in paths:
            signal = episode.signals[path]
            name, width = path.rpartition("/")[2], signal.values.shape[1]
            names = [f"{name}{f'.{i}' if width > 1 else ''} [{signal.unit}]" for i in range(width)]
            colors = [PALETTE[(color + i) % len(PALETTE)] for i in range(width)]
            color += width
            mode: Literal["Linear", "StepAfter"] = "Linear" if path.startswith("body/") else "StepAfter"
            style = rr.SeriesLines(names=names, colors=colors, widths=1.5, interpolation_mode=mode)
            stream.log(_entity(path), style, static=True)
            columns = rr.Scalars.columns(scalars=signal.values.ravel()).partition([width] * len(signal.ticks))
            stream.send_columns(_entity(path), episode.indexes(signal.ticks), columns)


def _log_rasters(stream: "rerun.RecordingStream", episode: Episode) -> None:
    import pyarrow
    import rerun as rr

    for step, raster in episode.rasters.items():
        # Without a range, the viewer would take the colours from 0..255. One more than there are layers, as the
        # colour map ends in a dark tone again.
        style = rr.Tensor.from_fields(value_range=(0, len(raster.neurons) + 1))
        stream.log(_entity(f"spikes/{step}"), style, static=True)
        tensors = [rr.encodings.TensorData(array=picture, dim_names=("neuron", "step")) for picture in raster.pictures]
        # A batch is made of one tensor only; a column takes any number of them as an Arrow array.
        column = pyarrow.concat_arrays([rr.components.TensorDataBatch(tensor).as_arrow_array() for tensor in tensors])
        columns = rr.Tensor.columns(data=column)
        stream.send_columns(_entity(f"spikes/{step}"), episode.indexes(raster.ticks), columns)


def _plots(episode: Episode, *groups: str) -> dict[str, list[str]]:
    """Return the paths that share a plot, by its title.

    A quantity of the body has its own plot; a step has one for each unit, and one for the rates of its layers.
    """
    regions = {use.name: use.region for use in episode.plan.uses()}
    plots: defaultdict[str, list[str]] = defaultdict(list)
    for path, signal in episode.signals.items():
        group, name = path.split("/")[:2]
        if group == "rates":
            title = f"{name} by {regions[name]}: spikes per neuron and step"
        elif group == "steps":
            title = f"{name} by {regions[name]} [{signal.unit}]"
        else:
            about = f": {signal.description.rstrip('.')}" if signal.description else ""
            title = f"{group}.{name}{about} [{signal.unit}]"
        if not groups or group in groups:
            plots[title].append(path)
    return dict(plots)


def _about(name: str, episode: Episode, scene: Scene | None) -> str:
    """Explain the recording, in Markdown."""
    clock = episode.plan.clock
    parts = [f"# {name}, seed {episode.seed}"]
    if scene is not None:
        parts.append(scene.legend)
    parts.append(
        f"**Plots**: a tick lasts {format_duration(clock.tick_ns)}. Sensors, if any, are read when it begins, and once "
        "more at the very end; commands and outputs hold from the beginning of a tick."
    )
    if episode.rasters:
        parts.append(
            f"**Spikes**: the latest window of a region, {clock.window} steps of "
            f"{format_duration(clock.spike_step_ns)} from left to right. A row is a neuron, a colour a layer, the "
            f"first layer lowest; {MOST_NEURONS}/1000 means that {MOST_NEURONS} of its 1000 neurons are shown."
        )
    return "\n\n".join(parts)


def _blueprint(episode: Episode, scene: Scene | None) -> "rerun.blueprint.Blueprint":
    """Lay out what a viewer sees first: an overview, and tabs with the spikes and the outputs of every step."""
    import rerun as rr
    import rerun.blueprint as rrb

    regions = {use.name: use.region for use in episode.plan.uses()}

    # Else the viewer shows a minute at most.
    whole = rr.TimeRange(start=rrb.TimeRangeBoundary.infinite(), end=rrb.TimeRangeBoundary.infinite())

    def plots(*groups: str) -> list[rrb.View]:
        views: list[rrb.View] = []
        for title, paths in _plots(episode, *groups).items():
            several = len(paths) > 1 or episode.signals[paths[0]].values.shape[1] > 1
            view = rrb.TimeSeriesView(
                name=title,
                contents=[f"+ {_entity(path)}" for path in paths],
                axis_x=rrb.TimeAxis(view_range=whole),
                plot_legend=rrb.PlotLegend(visible=several),
            )
            views.append(view)
        return views

    def raster(step: str) -> rrb.View:
        sizes = episode.rasters[step].neurons
        layers = [f"{layer} {f'{MOST_NEURONS}/' if size > MOST_NEURONS else ''}{size}" for layer, size in sizes.items()]
        return rrb.TensorView(
            name=f"{step} by {regions[step]}: {', '.join(layers)}",
            origin=_entity(f"spikes/{step}"),
            scalar_mapping=rrb.TensorScalarMapping(colormap="turbo", mag_filter="nearest"),
            view_fit="Fill",
        )

    signals, steps, rates = plots("body", "command"), plots("steps", "timing"), plots("rates")
    last_uses = {regions[step]: step for step in episode.rasters}.values()
    about = rrb.TextDocumentView(origin="/about", name="About")
    left = about if scene is None else rrb.Vertical(scene.view(), about, row_shares=[5, 2])
    columns = [rrb.Vertical(*views) for views in (signals or steps, [*map(raster, last_uses)]) if views]
    shares = [1 if scene is None else 2, *(2 for _ in columns)]
    tabs: list[rrb.Container] = [rrb.Horizontal(left, *columns, column_shares=shares, name="Overview")]
    if rates:
        rasters = rrb.Grid(*map(raster, episode.rasters))
        tabs.append(rrb.Vertical(rasters, rrb.Grid(*rates), row_shares=[3, 2], name="Spikes"))
    if signals and steps:
        tabs.append(rrb.Grid(*steps, name="Steps"))
    return rrb.Blueprint(
        rrb.Tabs(*tabs, active_tab=0),
        rrb.TimePanel(timeline="time", state="collapsed", play_state="playing", loop_mode="all"),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
    )
