"""`neurorobo new` makes what passes its own tests and the checks of this repository, and tells what cannot be."""

import os
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from neurorobo.cli.scaffold import LONGEST, SORTS, TEMPLATES, Names, write_plugin
from tests.cli.test_commands import call

PROJECT = Path(__file__).parents[2]


def make(folder: Path, prefix: str, name: str) -> list[Path]:
    """Write a plugin of each kind, and return their folders."""
    for kind in SORTS:
        write_plugin(kind, Names(prefix.format(kind=kind), name.format(kind=kind)), folder / kind)
    return [folder / kind for kind in SORTS]


def test_the_tests_of_every_kind_pass(tmp_path: Path) -> None:
    """In one process; those of a region are run by the test of the tutorial."""
    projects = [project for project in make(tmp_path, "my_{kind}", "a_{kind}") if project.name != "region"]
    paths = [*(str(project / "src") for project in projects), *filter(None, [os.environ.get("PYTHONPATH")])]
    command = [sys.executable, "-m", "pytest", "-W", "error", "--import-mode=importlib", *map(str, projects)]
    done = subprocess.run(
        command, cwd=tmp_path, env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)}, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize(
    ("prefix", "name"),
    [("my_{kind}", "a_{kind}"), ("a", "b"), ("p" * LONGEST, "n" * LONGEST)],
    ids=["usual", "short", "long"],
)
def test_linter_and_formatter_have_nothing_to_say_whatever_the_name(prefix: str, name: str, tmp_path: Path) -> None:
    settings = ["--config", str(PROJECT / "pyproject.toml"), "--no-cache"]
    for project in make(tmp_path, prefix, name):
        for command in (["check", *settings], ["format", "--check", *settings]):
            done = subprocess.run([sys.executable, "-m", "ruff", *command], cwd=project, capture_output=True, text=True)
            assert done.returncode == 0, f"{project.name}: {done.stdout}{done.stderr}"


def test_there_are_templates_of_every_kind_and_no_others() -> None:
    assert {folder.name for folder in TEMPLATES.iterdir()} == {"common", *SORTS}


def test_the_templates_are_installed_with_the_package() -> None:
    (pattern,) = (
        pattern
        for pattern in tomllib.loads((PROJECT / "pyproject.toml").read_text())["tool"]["setuptools"]["package-data"][
            "neurorobo"
        ]
        if "templates" in pattern
    )
    files = {path for path in TEMPLATES.rglob("*") if path.is_file()}
    assert files == set((PROJECT / "neurorobo").glob(pattern))


def test_it_prints_the_three_commands_to_type_next(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "a folder" / "project"
    code, out, err = call(capsys, monkeypatch, "new", "command", "my_lab.count_spikes", "--out", str(folder))
    assert (code, err) == (0, "")
    assert [shlex.split(line) for line in out.splitlines()[2:]] == [
        ["pip", "install", "-e", f"{folder}[test]"],
        ["pytest", str(folder)],
        ["neurorobo", "count-spikes", str(folder / "count_spikes.yaml")],
    ]
    assert (folder / "src" / "my_lab" / "plugin.py").exists()
    assert list(folder.parent.iterdir()) == [folder]  # nothing is left of how it was written


@pytest.mark.parametrize(
    ("kind", "name", "words"),
    [
        ("regoin", "mine", "there is no kind `regoin`; did you mean `region`?"),
        ("task", "mine", "a template of `task` comes with that of a body: `neurorobo new body` makes both"),
        ("data", "mine", "`neurorobo new region` makes both"),
        ("recorder", "mine", "there is no template of a recorder; there are: region, neuron, "),
        ("region", "My-Region", "`My-Region` is no name for a region; begin with a letter and use lower case"),
        ("region", "My-Region", "such as `my_region`"),
        ("region", "1", "such as `my_region`"),
        ("region", "a.b.c", "`a.b.c` is no name"),
        ("region", "a" * (LONGEST + 1), f"is longer than {LONGEST} letters; choose another name"),
        ("region", "lambda", "`lambda` is a word of Python or YAML; choose another name"),
        ("region", "mine.none", "its class would be called `None`, which is a word of Python; choose"),
        ("region", "core.mine", "`core` is the prefix of a plugin that is installed; choose another name"),
        ("region", "minimal", "`minimal` is the prefix of a plugin that is installed; choose another name"),
        ("region", "email", "`email` is a module of Python's own library; choose another name"),
        ("region", "torch", "`torch` is a module that is installed; choose another name"),
        ("region", "pyyaml", "`pyyaml` is a package that is installed; choose another name"),
        ("region", "mine.layer", "its class would be called `Layer`, as one that it needs is; choose another name"),
        ("rule", "mine.region", "its class would be called `Region`, as one that it needs is"),
        ("command", "mine.run", "`neurorobo run` is a command that there is; choose another name"),
    ],
)
def test_a_mistake_is_told_with_its_cure_and_nothing_is_written(
    kind: str,
    name: str,
    words: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    code, out, err = call(capsys, monkeypatch, "new", kind, name, "--out", str(tmp_path / "new"))
    assert (code, out) == (2, "")
    assert words in err
    assert len(err.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("there", ["file", "folder"])
def test_what_is_there_is_left_as_it_is(
    there: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    if there == "file":
        Path("mine").write_text("dear")
    else:
        Path("mine").mkdir()
    code, _, err = call(capsys, monkeypatch, "new", "region", "mine")
    assert (code, err) == (2, "mine exists already, and is left as it is; choose another place with `--out`\n")
    assert list(tmp_path.rglob("*")) == [tmp_path / "mine"]
    assert there == "folder" or Path("mine").read_text() == "dear"


def test_a_place_that_cannot_be_written_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    code, _, err = call(capsys, monkeypatch, "new", "region", "mine", "--out", str(tmp_path / "file" / "mine"))
    assert code == 2
    assert "cannot be written" in err
