"""What scripts rely on: exit codes, pure JSON, plugins' commands, and one line for what cannot be."""

import json
import shlex
import sys
from pathlib import Path

import pytest

from neurorobo.cli.main import main
from tests.cli.installed import install_plugin
from tests.cli.test_bad_input import GOOD

PLUGIN = """\
from neurorobo.plugins import hookimpl

@hookimpl
def neurorobo_register(registry):
    registry.add("command", "{prefix}.brew", "{module}:brew", "brews with {prefix}")
    registry.add("command", "{prefix}.run", "{module}:run", "runs away")
"""
BREW = """
import click

@click.command()
@click.option("--strong", is_flag=True)
def brew(strong):
    click.echo("{prefix}, strong" if strong else "{prefix}")
"""


def call(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, *arguments: str) -> tuple[int, str, str]:
    """Run the command line and return its exit code and what it says on both streams."""
    monkeypatch.setattr(sys, "argv", ["neurorobo", *arguments])
    with pytest.raises(SystemExit) as ended:
        main()
    said = capsys.readouterr()
    return int(ended.value.code or 0), said.out, said.err


def install(folder: Path, monkeypatch: pytest.MonkeyPatch, prefix: str, brew: str = BREW) -> None:
    """Leave a distribution with one plugin on the path; its commands have a module of their own."""
    module = f"{prefix}_tools"
    install_plugin(folder, monkeypatch, prefix, PLUGIN.format(prefix=prefix, module=module))
    (folder / f"{module}.py").write_text(brew.replace("{prefix}", prefix))
    monkeypatch.delitem(sys.modules, module, raising=False)


def test_a_plugin_s_command_is_listed_without_being_imported_and_called_with_its_options(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    install(tmp_path, monkeypatch, "kettle")
    code, out, _ = call(capsys, monkeypatch, "--help")
    assert code == 0
    assert "Brews with kettle." in out
    assert "kettle_tools" not in sys.modules
    assert call(capsys, monkeypatch, "brew", "--strong") == (0, "kettle, strong\n", "")
    assert "--strong" in call(capsys, monkeypatch, "brew", "--help")[1]


def test_the_help_shows_every_summary_to_its_end(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    install(tmp_path, monkeypatch, "a_kettle_whose_name_takes_more_room_than_a_line_of_the_help_has_for_a_summary")
    _, out, _ = call(capsys, monkeypatch, "--help")
    summaries = out.partition("Commands:")[2]
    assert "..." not in summaries
    assert "for_a_summary" in summaries


@pytest.mark.parametrize(("brew", "words"), [("1 / 0", "ZeroDivisionError"), ("brew = 3", "is no click command")])
def test_a_broken_command_harms_nothing_but_itself(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, brew: str, words: str
) -> None:
    install(tmp_path, monkeypatch, "kettle", brew)
    assert call(capsys, monkeypatch, "--help")[0] == 0
    code, _, err = call(capsys, monkeypatch, "brew")
    assert code == 2
    assert "kettle.brew" in err
    assert words in err


def test_of_two_commands_of_one_name_the_first_is_called_and_the_other_noted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    install(tmp_path, monkeypatch, "pot")
    install(tmp_path, monkeypatch, "kettle")
    assert call(capsys, monkeypatch, "brew") == (0, "kettle\n", "")
    _, out, _ = call(capsys, monkeypatch, "plugins")
    assert "cannot be called: `brew` is `kettle.brew`" in out.split("pot.brew")[1]
    assert "cannot be called: `brew`" not in out.split("pot  (")[0]
    assert out.count("cannot be called: `run` is a command of neurorobo's own") == 2


@pytest.mark.parametrize("arguments", [("graph", "x.yaml"), ("schema",)])
def test_a_file_can_be_written_into_a_folder_that_is_not_there_yet(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    arguments: tuple[str, ...],
) -> None:
    (tmp_path / "x.yaml").write_text(GOOD)
    monkeypatch.chdir(tmp_path)
    assert call(capsys, monkeypatch, *arguments, "--out", "new/folder/file") == (0, "", "")
    assert (tmp_path / "new" / "folder" / "file").stat().st_size > 0
    code, _, err = call(capsys, monkeypatch, *arguments, "--out", "x.yaml/file")
    assert code == 2
    assert err.startswith("x.yaml/file cannot be written")


def test_a_folder_without_figures_cannot_be_compared(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "summary.json").write_text("{}")
    code, _, err = call(capsys, monkeypatch, "compare", str(tmp_path))
    assert code == 2
    assert "is not the summary of a run" in err


BIG = """\
  - d: {use: big, force: c.mean, mean: c.mean, variance: c.variance}
"""


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            "steps:",
            "  big: {type: precision.cerebellum, period: control, granule_fan_in: 100000}\nsteps:",
            "x.yaml:9:3: regions.big: cannot be built: ",
        ),
        ("name: tiny", "name: tiny\nseed: 99999999999999999999", "x.yaml:3:1: seed: must be less than or equal to"),
    ],
)
def test_what_is_too_large_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, old: str, new: str, words: str
) -> None:
    file = tmp_path / "x.yaml"
    file.write_text(GOOD.replace(old, new, 1) + (BIG if "big" in new else ""))
    code, _, err = call(capsys, monkeypatch, "run", str(file), "--out", str(tmp_path / "out"))
    assert code == 2
    assert words in err


TEACHERS = Path(__file__).parents[2] / "examples" / "peg_in_hole_teachers.yaml"
TOO_SHORT = ("--set", "task={type: precision.insertion, time_limit: 2 s}", "--set", "record=[trajectory]")


def test_an_episode_that_fails_is_exit_code_3_of_a_run_and_none_of_a_comparison(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    out = ("--out", str(tmp_path / "my run"))
    code, said, _ = call(capsys, monkeypatch, "run", str(TEACHERS), *TOO_SHORT, "--json", *out)
    assert code == 3
    printed = json.loads(said)
    assert printed["aggregate"]["success"]["worst"] == 0.0
    assert json.loads((tmp_path / "my run" / "summary.json").read_text()) == {
        key: printed[key] for key in ("episodes", "aggregate")
    }
    typed = json.loads((tmp_path / "my run" / "run.json").read_text())["command"]
    assert shlex.split(typed) == ["neurorobo", "run", str(TEACHERS), *TOO_SHORT, "--json", *out]
    out = ("--out", str(tmp_path / "both"), "--episodes", "1", "--json")
    code, said, noted = call(capsys, monkeypatch, "compare", str(TEACHERS), str(tmp_path / "my run"), *TOO_SHORT, *out)
    assert code == 0
    assert {name: figures["aggregate"]["success"]["mean"] for name, figures in json.loads(said).items()} == {
        TEACHERS.stem: 0.0,
        str(tmp_path / "my run"): 0.0,
    }
    assert noted == f"{TEACHERS.stem}: {tmp_path / 'both' / TEACHERS.stem}\n"


def test_json_is_all_that_is_printed_and_notes_go_to_the_error_stream(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "x.yaml").write_text(GOOD)
    code, said, noted = call(
        capsys, monkeypatch, "run", str(tmp_path / "x.yaml"), "--json", "--out", str(tmp_path / "out")
    )
    assert code == 0
    assert set(json.loads(said)) == {"folder", "episodes", "aggregate"}
    assert noted == "note: the region `left` has no `weights`; it runs with fresh ones\n"
    code, said, noted = call(capsys, monkeypatch, "plugins", "--json")
    assert (code, noted) == (0, "")
    assert {plugin["name"] for plugin in json.loads(said)} >= {"core", "minimal"}


@pytest.mark.parametrize("command", ["run", "compare"])
def test_ctrl_c_is_exit_code_130_and_one_line_of_what_there_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("neurorobo.experiment.run.run_episodes", interrupt)
    (tmp_path / "x.yaml").write_text(GOOD)
    code, said, noted = call(capsys, monkeypatch, command, str(tmp_path / "x.yaml"), "--out", str(tmp_path / "out"))
    assert (code, said) == (130, "")
    (run,) = (tmp_path / "out").rglob("run.json")
    assert noted.splitlines()[-1] == f"interrupted; nothing was recorded yet, see {run.parent}"
    assert json.loads(run.read_text())["status"] == "interrupted"


def test_ctrl_c_says_that_training_goes_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("neurorobo.learning.supervise._loss", interrupt)
    phase = "{phase: supervise, region: mind, teacher: {type: precision.law, period: control}, "
    phase += "data: precision.insertion_speeds, loss: {mean: 1 mN}, steps: 3}"
    mind = "  mind: {type: precision.hippocampus, period: control}\nsteps:"
    (tmp_path / "x.yaml").write_text(GOOD.replace("steps:", mind) + f"train:\n  - {phase}\n")
    out = tmp_path / "out"
    code, said, noted = call(capsys, monkeypatch, "train", str(tmp_path / "x.yaml"), "--out", str(out))
    assert (code, said) == (130, "")
    assert noted.splitlines()[-1] == f"interrupted; the same command goes on from what is in {out}"
