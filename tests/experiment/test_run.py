"""A run and the folder that it leaves behind."""

import errno
import hashlib
import json
from collections.abc import Sequence
from pathlib import Path

import pyarrow.parquet
import pytest
import torch

from neurorobo.config.experiment import load_experiment
from neurorobo.errors import ConfigError, NeuroroboError
from neurorobo.experiment import run as run_module
from neurorobo.experiment.build import build_brain
from neurorobo.experiment.recorder import Setting
from neurorobo.experiment.run import FinishedRun, run_experiment
from neurorobo.experiment.run_folder import RunFolder, new_folder_path
from neurorobo.experiment.weights import weights_file
from neurorobo.regions.weights import save_weights
from tests.engine.paths import engine
from tests.experiment.toys import CART, Notes, registry
from tests.regions.toys import net


def run(
    folder: Path, seeds: Sequence[int] = (3, 4), text: str = CART, record: Sequence[str] | None = None
) -> FinishedRun:
    file = folder / "cart.yaml"
    file.write_text(text)
    types = registry()
    return run_experiment(load_experiment(file, (), types), types, seeds, folder / "out", record=record)


def table(folder: Path) -> pyarrow.Table:
    return pyarrow.parquet.read_table(folder / "out" / "trajectory.parquet")


def test_a_finished_run_says_what_was_run_and_what_came_of_it(tmp_path: Path) -> None:
    finished = run(tmp_path)
    folder = RunFolder(tmp_path / "out")
    content = folder.run()
    assert content["status"] == "finished"
    assert content["seeds"] == [3, 4]
    assert content["started"] <= content["ended"]
    assert {"torch", "numpy"} <= content["versions"].keys()
    assert content["command"] is None  # nothing was typed
    assert folder.summary() == finished.summary
    assert [episode["seed"] for episode in finished.summary["episodes"]] == [3, 4]
    assert set(finished.summary["aggregate"]) == {
        "duration_s",
        "success",
        "error_um",
        "command_interventions",
        "firing_rate.watcher",
        "saturations",
        "saturations.watch.force",
    }
    assert (folder.path / "config.yaml").read_text() == CART
    assert [file.name for file in finished.files] == ["trajectory.parquet"]


def test_the_resolved_configuration_gives_the_same_run_again(tmp_path: Path) -> None:
    first = run(tmp_path)
    resolved = (tmp_path / "out" / "config.resolved.yaml").read_text()
    again = tmp_path / "again"
    again.mkdir()
    second = run(again, text=resolved)
    assert second.summary == first.summary
    assert table(again).equals(table(tmp_path))
    assert (again / "out" / "config.resolved.yaml").read_text() == resolved


def test_the_resolved_configuration_says_where_the_seeds_of_the_episodes_are(tmp_path: Path) -> None:
    run(tmp_path, seeds=(3, 4))  # the file says 7, which drew the weights of the watcher
    note, content = (tmp_path / "out" / "config.resolved.yaml").read_text().split("\n", 1)
    assert note.startswith("# The seeds of the episodes are in run.json; ")
    assert "seed: 7\n" in content
    assert RunFolder(tmp_path / "out").run()["seeds"] == [3, 4]


def test_the_trajectory_has_a_row_per_episode_and_tick_with_units_and_gaps(tmp_path: Path) -> None:
    finished = run(tmp_path)
    trajectory = table(tmp_path)
    assert trajectory.column_names[:3] == ["seed", "tick", "time_s"]
    units = {field.name: (field.metadata or {}).get(b"unit", b"").decode() for field in trajectory.schema}
    assert units == {
        "seed": "",
        "tick": "",
        "time_s": "",
        "body.force.0": "mN",
        "body.force.1": "mN",
        "body.position.0": "um",
        "body.position.1": "um",
        "command.speed": "um/s",
        "command.nudge.0": "um",
        "command.nudge.1": "um",
        "command.speed.interventions": "",
        "command.nudge.interventions": "",
        "drive.speed": "um/s",
        "drive.nudge.0": "um",
        "drive.nudge.1": "um",
        "watch.move": "um",
    }
    rows = trajectory.to_pylist()
    lengths = [int(episode["duration_s"]) for episode in finished.summary["episodes"]]
    assert len(set(lengths)) == 2
    assert [(row["seed"], row["tick"]) for row in rows] == [
        (seed, tick) for seed, length in zip((3, 4), lengths, strict=True) for tick in range(length)
    ]
    for row in rows:
        assert row["time_s"] == row["tick"]
        assert row["command.speed"] == pytest.approx(min(1.0, row["drive.speed"]), rel=1e-6)
        assert row["drive.speed"] == pytest.approx(4 * (3.5 - row["body.position.0"]), rel=1e-5)
        assert (row["watch.move"] is None) == (row["tick"] % 2 == 1)
        assert None not in {value for name, value in row.items() if name != "watch.move"}


def test_more_episodes_than_fit_in_a_batch_follow_in_another(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_module, "LARGEST_BATCH", 2)
    in_two = run(tmp_path, seeds=(3, 4, 5))
    monkeypatch.undo()
    (tmp_path / "once").mkdir()
    at_once = run(tmp_path / "once", seeds=(3, 4, 5))
    assert in_two.summary == at_once.summary
    assert table(tmp_path).equals(table(tmp_path / "once"))


@pytest.mark.parametrize(
    ("recorder", "error", "status"),
    [("toy.impatient", KeyboardInterrupt, "interrupted"), ("toy.clumsy", ZeroDivisionError, "failed")],
)
def test_a_run_that_breaks_off_says_so_and_keeps_what_was_recorded(
    tmp_path: Path, recorder: str, error: type[BaseException], status: str
) -> None:
    with pytest.raises(error) as raised:
        run(tmp_path, record=["trajectory", recorder])
    if error is KeyboardInterrupt:
        assert str(raised.value) == f"what was recorded until then is in {tmp_path / 'out'}"
    folder = RunFolder(tmp_path / "out")
    assert folder.run()["status"] == status
    assert folder.run()["ended"]
    assert set(table(tmp_path)["tick"].to_pylist()) == {0, 1, 2}
    with pytest.raises(NeuroroboError, match=r"has no summary.json: it is not the folder of a finished run"):
        folder.summary()


def test_an_interrupted_run_says_how_its_body_stands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("neurorobo.bodies.body.Body.standstill", lambda _: "all axes stand")
    with pytest.raises(KeyboardInterrupt, match="all axes stand; what was recorded until then is in "):
        run(tmp_path, record=["trajectory", "toy.impatient"])


def test_a_body_that_fails_as_it_is_let_go_of_fails_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls = iter([NeuroroboError("it does not stand"), None])

    def close(_: object) -> None:
        if (error := next(calls)) is not None:
            raise error

    monkeypatch.setattr("neurorobo.bodies.body.Body.close", close)
    with pytest.raises(NeuroroboError, match="it does not stand"):
        run(tmp_path)
    left = RunFolder(tmp_path / "out").run()
    assert (left["status"], left["error"]) == ("failed", "it does not stand")


def test_a_folder_that_holds_a_run_is_not_written_over(tmp_path: Path) -> None:
    run(tmp_path)
    before = (tmp_path / "out" / "run.json").read_text()
    with pytest.raises(NeuroroboError, match=r"already holds a run; give another folder with `--out`"):
        run(tmp_path, seeds=(9,))
    assert (tmp_path / "out" / "run.json").read_text() == before


def test_a_place_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("a file")
    with pytest.raises(NeuroroboError, match=r"out cannot be written .*; make room for it, or choose another place"):
        run(tmp_path)


def test_a_run_without_a_task_lasts_as_long_as_the_file_says(tmp_path: Path) -> None:
    text = """\
neurorobo: 1
name: alone
time: {control: 1 s, window: 20}
episode: {duration: 5 s}
regions: {watcher: {type: toy.net}}
steps:
  - watch: {use: watcher}
record: [trajectory]
"""
    finished = run(tmp_path, seeds=(0,), text=text)
    assert table(tmp_path)["tick"].to_pylist() == [0, 1, 2, 3, 4]
    assert set(finished.summary["aggregate"]) == {"firing_rate.watcher", "saturations"}


def test_a_spoilt_summary_is_named(tmp_path: Path) -> None:
    run(tmp_path)
    (tmp_path / "out" / "summary.json").write_text("{")
    with pytest.raises(NeuroroboError, match=r"summary.json cannot be read .*; run the experiment again"):
        RunFolder(tmp_path / "out").summary()


def test_folders_of_one_second_get_different_names(tmp_path: Path) -> None:
    paths = []
    for _ in range(3):
        paths.append(new_folder_path(tmp_path, "cart", "0123456789abcdef"))
        paths[-1].mkdir(parents=True)
    assert len(set(paths)) == 3
    assert all(path.parent == tmp_path / "cart" and "01234567" in path.name for path in paths)


def test_a_run_remembers_which_weights_it_used_and_finds_them_beside_its_file(tmp_path: Path) -> None:
    text = CART.replace("{type: toy.net}", "{type: toy.net, weights: net.safetensors}")
    with pytest.raises(ConfigError, match=r"cart.yaml:9:.*: regions.watcher.weights: there is no weights file"):
        run(tmp_path, text=text)
    save_weights(net(seed=5), tmp_path / "net.safetensors", {})
    trained = run(tmp_path, text=text)
    digest = hashlib.sha256((tmp_path / "net.safetensors").read_bytes()).hexdigest()
    assert RunFolder(tmp_path / "out").run()["weights_sha256"] == {"watcher": digest}
    (tmp_path / "fresh").mkdir()
    fresh = run(tmp_path / "fresh")
    rates = [summary["aggregate"]["firing_rate.watcher"]["mean"] for summary in (trained.summary, fresh.summary)]
    assert rates[0] != rates[1]


@pytest.mark.parametrize(
    ("overrides", "folder"),
    [
        ((), "file"),
        (("regions.driver.gain=3",), "file"),
        (("regions.watcher.weights=net.safetensors",), "typed"),
        (("regions.watcher={type: toy.net, weights: net.safetensors}",), "typed"),
    ],
)
def test_weights_are_found_from_the_file_that_names_them_or_from_where_an_override_is_typed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, overrides: Sequence[str], folder: str
) -> None:
    for name in ("file", "typed"):
        (tmp_path / name).mkdir()
    file = tmp_path / "file" / "cart.yaml"
    file.write_text(CART.replace("{type: toy.net}", "{type: toy.net, weights: net.safetensors}"))
    monkeypatch.chdir(tmp_path / "typed")
    experiment = load_experiment(file, overrides, registry())
    assert weights_file("watcher", experiment) == tmp_path / folder / "net.safetensors"


def test_the_summary_is_plain_json(tmp_path: Path) -> None:
    run(tmp_path, seeds=(3,))
    text = (tmp_path / "out" / "summary.json").read_text()
    assert json.loads(text)["aggregate"]["success"] == {"mean": 1.0, "standard_error": None, "worst": 1.0}
    assert "NaN" not in text


class Greedy(Notes):
    """Cannot write its file."""

    def finish(self) -> Path | None:
        raise OSError("no space left")


def test_a_recorder_that_cannot_write_leaves_the_figures_and_the_others_files(tmp_path: Path) -> None:
    with pytest.raises(NeuroroboError, match=r"out cannot be written \(no space left\); make room for it"):
        run(tmp_path, record=["toy.greedy", "trajectory"])
    folder = RunFolder(tmp_path / "out")
    assert folder.run()["status"] == "failed"
    assert set(folder.summary()["aggregate"]) > {"success"}
    assert table(tmp_path).num_rows > 0


def test_a_recorder_that_fails_last_does_not_hide_why_the_run_did(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(ZeroDivisionError):
        run(tmp_path, record=["toy.greedy", "toy.clumsy", "trajectory"])
    said = capsys.readouterr().err
    assert "a recorder failed too: " in said and "cannot be written (no space left)" in said
    assert RunFolder(tmp_path / "out").run()["status"] == "failed"
    assert table(tmp_path).num_rows > 0


class Unmade(Notes):
    """Cannot be made."""

    def __init__(self, setting: Setting) -> None:
        raise ZeroDivisionError


def test_a_run_whose_recorder_cannot_be_made_does_not_stay_running(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError):
        run(tmp_path, record=["toy.unmade"])
    assert RunFolder(tmp_path / "out").run()["status"] == "failed"


def test_a_run_that_cannot_begin_leaves_no_folder_in_the_way_of_the_next(tmp_path: Path) -> None:
    with pytest.raises(NeuroroboError, match=r"unknown recorder `toy.tape`"):
        run(tmp_path, record=["toy.tape"])
    with engine("nonsense"), pytest.raises(NeuroroboError, match=r"NEUROROBO_ENGINE is .*, not 'nonsense'"):
        run(tmp_path)
    assert not (tmp_path / "out").exists()
    assert run(tmp_path).folder.run()["status"] == "finished"


def test_a_full_disk_does_not_hide_why_a_run_failed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(self: Path, content: bytes) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    def break_off(*_: object, **__: object) -> None:
        monkeypatch.setattr(Path, "write_bytes", full)
        raise ZeroDivisionError

    monkeypatch.setattr(run_module, "run_episodes", break_off)
    with pytest.raises(ZeroDivisionError):
        run(tmp_path, record=[])
    assert "run.json cannot be written (No space left on device)" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("old", "new", "place"),
    [
        (
            "{type: toy.net}",
            "{type: toy.missing}",
            "cart.yaml:9:3: regions.watcher: `tests.experiment.gone:Gone` cannot",
        ),
        (
            "{type: toy.net}",
            "{type: toy.fileless}",
            "cart.yaml:9:3: regions.watcher: cannot be built: [Errno 2] No such",
        ),
        ("{type: toy.cart, noise: 0.8}", "{type: toy.broken_cart}", "cart.yaml:5:1: body: cannot be built: no cart"),
        ("{type: toy.reach}", "{type: toy.far_reach}", "cart.yaml:6:1: task: the goal is too far for this body"),
    ],
)
def test_what_cannot_be_built_is_named_with_its_place(tmp_path: Path, old: str, new: str, place: str) -> None:
    with pytest.raises(ConfigError) as caught:
        run(tmp_path, text=CART.replace(old, new))
    assert place in str(caught.value)
    assert not (tmp_path / "out").exists()


def test_a_region_that_no_step_uses_is_neither_built_nor_spoken_of(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run(tmp_path, text=CART.replace("steps:", "  spare: {type: toy.missing}\nsteps:"))
    assert capsys.readouterr().err == "note: the region `watcher` has no `weights`; it runs with fresh ones\n"


def test_weights_of_a_region_that_no_step_uses_are_not_needed(tmp_path: Path) -> None:
    spare = "  spare: {type: toy.net, weights: nowhere.safetensors}\nsteps:"
    run(tmp_path, text=CART.replace("steps:", spare))
    assert RunFolder(tmp_path / "out").run()["weights_sha256"] == {}


@pytest.mark.parametrize(
    "content", ["{}", "[]", '{"episodes": [], "aggregate": {"success": 1}}', '{"episodes": 1, "aggregate": {}}']
)
def test_what_is_no_summary_is_refused(tmp_path: Path, content: str) -> None:
    (tmp_path / "summary.json").write_text(content)
    with pytest.raises(NeuroroboError, match=r"summary.json .*; run the experiment again"):
        RunFolder(tmp_path).summary()


def test_regions_of_one_type_get_fresh_weights_of_their_own_and_equal_seeds_equal_ones(tmp_path: Path) -> None:
    file = tmp_path / "cart.yaml"
    file.write_text(
        CART.replace("steps:", "  other: {type: toy.net}\nsteps:").replace(
            "command:", "  - see: {use: other, force: body.force}\ncommand:"
        )
    )
    experiment = load_experiment(file, (), registry())
    first, again = build_brain(experiment), build_brain(experiment)
    weights = [
        torch.cat([p.detach().flatten() for p in brain.region(name).parameters()])
        for brain in (first, again)
        for name in ("watcher", "other")
    ]
    assert torch.equal(weights[0], weights[2]) and torch.equal(weights[1], weights[3])
    assert not torch.equal(weights[0], weights[1])
