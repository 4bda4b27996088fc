"""The recording of a run, read back from its file."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
import pytest
import rerun as rr
import rerun.blueprint as rrb
import torch
from rerun.chunk import RrdReader

from neurorobo.bodies import Array
from neurorobo.experiment.closed_loop import EpisodeResult, run_episodes
from neurorobo.experiment.recorder import LayerSpikes, Sample, Setting
from neurorobo.tasks.task import Task
from neurorobo.views.recording import Episode, RerunRecorder
from tests.experiment.toys import SECOND, Notes, brain
from tests.tasks.toys import Cart, CartConfig, Reach, ReachConfig, reach

SEEDS = [6, 3, 4, 5]  # the first one ends before the others
BRAIN = brain()


class ToyScene:
    """Marks how far the cart has come."""

    legend = "A **cart** on its rail."

    def __init__(self, setting: Setting) -> None:
        assert isinstance(setting.task, Reach)
        self.goal_um = setting.task.config.goal_um

    def log(self, stream: rr.RecordingStream, episode: Episode) -> None:
        position = episode.signals["body/position"]
        stream.log("scene/goal", rr.Points3D([[self.goal_um, 0.0, 0.0]]), static=True)
        place = np.column_stack([position.values, np.zeros(len(position.ticks))])
        stream.send_columns("scene/cart", episode.indexes(position.ticks), rr.Transform3D.columns(translation=place))

    def view(self) -> rrb.View:
        return rrb.Spatial3DView(origin="/scene", name="A cart")


class DrawnReach(Reach):
    scene = "tests.views.test_recording:ToyScene"


class ShakyCart(Cart):
    """Its sensor draws its noise from the generator that also moves the cart."""

    def read(self) -> dict[str, Array]:
        noise = np.array([generator.standard_normal(2) for generator in self.generators]).reshape(-1, 2)
        return {**super().read(), "force": 0.1 * noise}


def setting(folder: Path, seeds: list[int], task: Task[Any] | None = None) -> Setting:
    return Setting(folder, "cart", BRAIN.plan, seeds, task)


def record(folder: Path, seeds: list[int], task: Reach | None = None) -> tuple[Path, list[Sample]]:
    """Run one episode per seed; return the recording and all samples."""
    task = task or reach(0.3)
    recorder, notes = RerunRecorder(setting(folder, seeds, task)), Notes()
    run_episodes(BRAIN, task, seeds, recorders=[recorder, notes])
    path = recorder.finish()
    assert path is not None
    return path, notes.samples


def read(path: Path) -> tuple[dict[str, pyarrow.Table], dict[str, dict[str, Any]]]:
    """Return the columns of each entity, and its static components."""
    columns: dict[str, list[pyarrow.RecordBatch]] = {}
    static: dict[str, dict[str, Any]] = {}
    for chunk in RrdReader(path).stream().to_chunks():
        batch = chunk.to_record_batch()
        if chunk.is_static:
            static.setdefault(chunk.entity_path, {}).update(batch.to_pylist()[0])
        else:
            columns.setdefault(chunk.entity_path, []).append(batch)
    return {entity: pyarrow.Table.from_batches(batches).sort_by("tick") for entity, batches in columns.items()}, static


def scalars(table: pyarrow.Table) -> list[list[float]]:
    return table["Scalars:scalars"].to_pylist()


def pictures(table: pyarrow.Table) -> list[np.ndarray]:
    tensors = [cell[0] for cell in table["Tensor:data"].to_pylist()]
    return [np.array(tensor["buffer"]).reshape(tensor["shape"]) for tensor in tensors]


def test_every_number_of_the_first_episode_reads_back(tmp_path: Path) -> None:
    path, samples = record(tmp_path, SEEDS)
    columns, _ = read(path)
    lived = [sample for sample in samples if sample.running[0]]
    assert 1 < len(lived) < len(samples)
    for name in ("force", "position"):
        expected = [sample.observation[name][0].tolist() for sample in samples[: len(lived) + 1]]
        assert scalars(columns[f"/body/{name}"]) == expected
    for name in ("speed", "nudge"):
        expected = [sample.given[name][0].tolist() for sample in lived]
        assert scalars(columns[f"/command/{name}"]) == expected
        expected = [sample.outputs["drive"][name][0].tolist() for sample in lived]
        assert scalars(columns[f"/steps/drive/{name}"]) == expected
    slow = columns["/steps/watch/move"]
    assert slow["tick"].to_pylist() == list(range(0, len(lived), 2))
    assert slow["time"].cast(pyarrow.int64()).to_pylist() == [tick * SECOND for tick in slow["tick"].to_pylist()]
    assert scalars(slow) == [sample.outputs["watch"]["move"][0].tolist() for sample in lived[::2]]


def test_a_recording_is_the_same_alone_and_in_a_batch(tmp_path: Path) -> None:
    together, alone = tmp_path / "together", tmp_path / "alone"
    together.mkdir()
    alone.mkdir()
    in_batch, _ = read(record(together, SEEDS)[0])
    by_itself, _ = read(record(alone, SEEDS[:1])[0])
    assert in_batch.keys() == by_itself.keys()
    for entity, table in in_batch.items():
        if entity == "/timing/latency":  # by the wall clock
            continue
        data = [name for name in table.column_names if not name.startswith("rerun.controls")]
        assert table.select(data).equals(by_itself[entity].select(data)), entity


def test_the_last_reading_is_what_the_episode_ended_with(tmp_path: Path) -> None:
    task = reach(0.3)
    path, samples = record(tmp_path, [3], task)
    columns, _ = read(path)
    position = columns["/body/position"]
    assert position["tick"].to_pylist()[-1] == len(samples)
    assert scalars(position)[-1] == task.body.position[0].tolist()


def test_recording_changes_nothing_even_if_reading_a_sensor_does(tmp_path: Path) -> None:
    def run(*recorders: RerunRecorder, task: Reach) -> list[EpisodeResult]:
        return run_episodes(BRAIN, task, SEEDS, recorders=recorders)

    def shaky() -> Reach:
        return Reach(ReachConfig(), ShakyCart(CartConfig(noise=0.3)))

    task = shaky()
    assert run(RerunRecorder(setting(tmp_path, SEEDS, task)), task=task) == run(task=shaky())


def test_series_are_named_by_quantity_component_and_unit(tmp_path: Path) -> None:
    _, static = read(record(tmp_path, [3])[0])
    names = {entity: components.get("SeriesLines:names") for entity, components in static.items()}
    assert names["/body/position"] == ["position.0 [um]", "position.1 [um]"]
    assert names["/command/speed"] == ["speed [um/s]"]
    assert names["/steps/drive/nudge"] == ["nudge.0 [um]", "nudge.1 [um]"]
    assert names["/rates/watch/hidden"] == ["hidden [1]"]


def test_every_spike_reads_back(tmp_path: Path) -> None:
    path, samples = record(tmp_path, SEEDS)
    columns, _ = read(path)
    watched = [sample.spikes["watch"] for sample in samples if sample.running[0] and sample.spikes]
    assert columns["/spikes/watch"]["tick"].to_pylist() == list(range(0, 2 * len(watched), 2))
    shown = pictures(columns["/spikes/watch"])
    assert len(shown) == len(watched)
    for picture, layers in zip(shown, watched, strict=True):
        hidden, output = (layers[name].some[:, 0].T for name in ("hidden", "output"))
        upwards = picture[::-1]  # the first neuron of the first layer is lowest
        assert (upwards[: len(hidden)] == hidden).all()
        assert (upwards[-len(output) :] == 2 * output.astype(int)).all()
        assert not upwards[len(hidden) : -len(output)].any()
    for layer in ("hidden", "output"):
        expected = [[float(layers[layer].some[:, 0].mean())] for layers in watched]
        np.testing.assert_allclose(scalars(columns[f"/rates/watch/{layer}"]), expected, rtol=1e-6)


def test_of_a_large_layer_evenly_spaced_neurons_are_shown(tmp_path: Path) -> None:
    recorder = RerunRecorder(setting(tmp_path, [0]))
    spikes = torch.zeros(20, 1, 1000)
    spikes[:, :, 999] = 1.0  # the last one fires always, the others never
    spiked = {"watch": {"hidden": LayerSpikes.of(spikes, spikes.sum((0, 2)), RerunRecorder.most_neurons)}}
    recorder.sample(Sample(0, 0.0, np.array([True]), {}, {}, {}, {}, {}, spiked, [0]))
    path = recorder.finish()
    assert path is not None
    columns, _ = read(path)
    (picture,) = pictures(columns["/spikes/watch"])
    assert picture.shape == (64, 20)
    assert picture[0].all() and not picture[1:].any()
    assert scalars(columns["/rates/watch/hidden"]) == [[pytest.approx(0.001)]]


def test_of_a_batch_the_first_episode_alone_is_kept() -> None:
    spikes = (torch.rand(20, 3, 70) < 0.3).float()
    kept = LayerSpikes.of(spikes, spikes.sum((0, 2)), 64).of_first()
    assert kept.some.shape == (20, 1, 64)
    assert kept.some.base is None
    assert kept.rate.tolist() == pytest.approx([float(spikes[:, 0].mean())])


def test_a_recording_that_cannot_be_written_is_the_system_s_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(stream: rr.RecordingStream) -> None:
        raise RuntimeError("File-writer thread shut down prematurely")

    recorder = RerunRecorder(setting(tmp_path, [0]))
    outputs = {"drive": {"speed": torch.ones(1, 1)}}
    recorder.sample(Sample(0, 0.0, np.array([True]), {}, {}, {}, {}, outputs, {}, [0]))
    with monkeypatch.context() as patch, pytest.raises(OSError, match="shut down prematurely"):
        patch.setattr(rr.RecordingStream, "flush", full)
        recorder.finish()


def test_a_brain_without_body_and_spikes_is_recorded_too(tmp_path: Path) -> None:
    recorder = RerunRecorder(setting(tmp_path, [0]))
    outputs = {"drive": {"speed": torch.ones(1, 1)}}
    recorder.sample(Sample(0, 0.0, np.array([True]), {}, {}, {}, {}, outputs, {}, [0]))
    path = recorder.finish()
    assert path is not None
    columns, _ = read(path)
    assert columns.keys() == {"/steps/drive/speed"}


def test_the_recording_says_what_was_run(tmp_path: Path) -> None:
    path, _ = record(tmp_path, [3])
    assert path == tmp_path / "recording.rrd"
    _, static = read(path)
    experiment = static["/__properties/experiment"]
    expected = {"name": ["cart"], "seed": [3], "tick_ns": [SECOND], "spike_step_ns": [1_000_000], "window": [20]}
    assert {key: experiment[key] for key in expected} == expected
    assert "cart, seed 3" in static["/about"]["TextDocument:text"][0]


def test_the_file_is_whole(tmp_path: Path) -> None:
    path, _ = record(tmp_path, [3])
    verified = subprocess.run([sys.executable, "-m", "rerun", "rrd", "verify", str(path)], capture_output=True)
    assert verified.returncode == 0, verified.stderr


def layout(path: Path) -> dict[str, list[Any]]:
    """Return all values of each component of the layout that the file brings."""
    reader = RrdReader(path)
    (blueprint,) = reader.blueprints()
    values: dict[str, list[Any]] = {}
    for chunk in reader.stream(store=blueprint).to_chunks():
        batch = chunk.to_record_batch()
        for name in filter(lambda name: ":" in name, batch.schema.names):
            values.setdefault(name, []).extend(cell for row in batch[name].to_pylist() for cell in row)
    return values


def test_the_file_brings_a_layout_that_shows_everything_once(tmp_path: Path) -> None:
    path, _ = record(tmp_path, [3])
    columns, _ = read(path)
    shown = layout(path)
    assert shown["TimePanelBlueprint:timeline"] == ["time"]
    assert {"Overview", "Spikes", "Steps"} <= set(shown["ContainerBlueprint:display_name"])
    assert {
        "About",
        "body.force [mN]",
        "command.speed [um/s]",
        "drive by driver [um]",
        "watch by watcher: hidden 10, output 6",
        "watch by watcher: spikes per neuron and step",
    } <= set(shown["ViewBlueprint:display_name"])
    plotted = [query.removeprefix("+ ") for query in shown["ViewContents:query"] if query.startswith("+ ")]
    assert sorted(plotted) == sorted(entity for entity in columns if not entity.startswith("/spikes"))
    assert "/spikes/watch" in shown["ViewBlueprint:space_origin"]


def test_a_task_brings_its_own_scene(tmp_path: Path) -> None:
    task = DrawnReach(ReachConfig(), Cart(CartConfig(noise=0.3)))
    path, samples = record(tmp_path, [3], task)
    columns, static = read(path)
    places = columns["/scene/cart"]["Transform3D:translation"].to_pylist()
    expected = [[*sample.observation["position"][0], 0.0] for sample in samples]
    np.testing.assert_allclose([place[0] for place in places[:-1]], expected, rtol=1e-6)
    assert len(places) == len(samples) + 1
    assert static["/scene/goal"]["Points3D:positions"] == [[3.0, 0.0, 0.0]]
    assert "A **cart** on its rail." in static["/about"]["TextDocument:text"][0]


def test_a_run_interrupted_before_its_first_tick_leaves_no_file(tmp_path: Path) -> None:
    assert RerunRecorder(setting(tmp_path, [3], reach())).finish() is None
    assert list(tmp_path.iterdir()) == []
