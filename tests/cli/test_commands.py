"""What the commands do with plugins' commands, folders that are not there, and sizes that cannot be built."""

import sys
from pathlib import Path

import pytest

from neurorobo.cli.main import main
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
    monkeypatch.syspath_prepend(str(folder))
    module = f"{prefix}_tools"
    (folder / f"{prefix}_nr.py").write_text(PLUGIN.format(prefix=prefix, module=module))
    (folder / f"{module}.py").write_text(brew.replace("{prefix}", prefix))
    info = folder / f"{prefix}_nr-0.2.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {prefix}-nr\nVersion: 0.2\n")
    (info / "entry_points.txt").write_text(f"[neurorobo.plugins]\n{prefix} = {prefix}_nr\n")
    for name in (f"{prefix}_nr", module):
        monkeypatch.delitem(sys.modules, name, raising=False)


def test_a_plugin_s_command_is_listed_without_being_imported_and_called_with_its_options(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    install(tmp_path, monkeypatch, "kettle")
    code, out, _ = call(capsys, monkeypatch, "--help")
    assert code == 0
    assert "brews with kettle" in out
    assert "kettle_tools" not in sys.modules
    assert call(capsys, monkeypatch, "brew", "--strong") == (0, "kettle, strong\n", "")
    assert "--strong" in call(capsys, monkeypatch, "brew", "--help")[1]


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
