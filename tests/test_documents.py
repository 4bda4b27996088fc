"""The documents are true: commands run, links lead somewhere, names exist, excerpts are what they say."""

import json
import os
import pkgutil
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import nullcontext
from pathlib import Path

import click
import pytest

PROJECT = Path(__file__).parent.parent
BUNDLE = "plugins/precision_interaction"
DOCUMENTS = [
    *(PROJECT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", f"{BUNDLE}/README.md")),
    *sorted((PROJECT / "docs").rglob("*.md")),
]
CONSOLE = re.compile(r"^```console\n(.*?)^```", re.DOTALL | re.MULTILINE)
EXCERPT = re.compile(r"<!-- from (\S+) -->\n+```yaml\n(.*?)^```", re.DOTALL | re.MULTILINE)
CAPTIONED = re.compile(r"^```\{code-block\} \w+\n:caption: (\S+)\n\n(.*?)^```", re.DOTALL | re.MULTILINE)
COMMANDS = [
    command
    for block in CONSOLE.findall((PROJECT / "README.md").read_text())
    for command in re.findall(r"^\$ (.+)$", block, re.MULTILINE)
    if command not in ("make run", "make test")  # they set up what is running here
]
REGION_GUIDE = PROJECT / "docs" / "how_to" / "write_a_region.md"

documents = pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(PROJECT)))


def prose(document: Path) -> str:
    """The text without its fenced blocks."""
    return re.sub(r"^```.*?^```", "", document.read_text(), flags=re.DOTALL | re.MULTILINE)


def environment(home: Path, **more: str) -> dict[str, str]:
    """An activated environment with a home of its own."""
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    return {**os.environ, "PATH": path, "HOME": str(home), "XDG_CONFIG_HOME": str(home), **more}


def run(command: list[str], folder: Path, variables: Mapping[str, str]) -> None:
    """Run a command, or fail with what it printed."""
    done = subprocess.run(
        command, cwd=folder, env=variables, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=300
    )
    assert done.returncode == 0, f"$ {shlex.join(command)}\n{done.stdout}"


@pytest.fixture(scope="module")
def reader(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which a reader of the README types; later commands use what earlier ones wrote."""
    folder = tmp_path_factory.mktemp("reader")
    for name in ("docs", "examples", "plugins"):
        (folder / name).symlink_to(PROJECT / name)
    # In place of the viewer's window: read the recording that would be shown.
    viewer = folder / "viewer" / "rerun" / "__main__.py"
    viewer.parent.mkdir(parents=True)
    (viewer.parent / "__init__.py").touch()
    viewer.write_text(
        "import os, subprocess, sys\n"
        "recording, = (name for name in sys.argv if name.endswith('.rrd'))\n"
        "del os.environ['PYTHONPATH']\n"
        "sys.exit(subprocess.call(['rerun', 'rrd', 'verify', recording]))\n"
    )
    return folder


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_of_the_readme_runs(command: str, reader: Path) -> None:
    shown = {"PYTHONPATH": str(reader / "viewer")} if command.startswith("neurorobo view") else {}
    run(shlex.split(command), reader, environment(reader, **shown))


@documents
def test_links_lead_somewhere(document: Path) -> None:
    targets = re.findall(r"\]\(([^)\s]+)\)", prose(document))
    local = [target.partition("#")[0] for target in targets if "://" not in target]
    assert [target for target in local if target and not (document.parent / target).exists()] == []


@documents
def test_named_files_exist(document: Path) -> None:
    paths = re.findall(r"`((?:neurorobo|plugins|examples|benchmarks|tests|docs|…)/[\w./-]*)`", prose(document))
    places = [path.replace("…", f"{BUNDLE}/precision_interaction") for path in paths]
    assert [place for place in places if not (PROJECT / place).exists()] == []


@documents
def test_named_objects_exist(document: Path) -> None:
    missing = []
    for name in re.findall(r"`((?:neurorobo|precision_interaction)(?:\.\w+)+)`", prose(document)):
        try:
            pkgutil.resolve_name(name)
        except (AttributeError, ImportError):
            missing.append(name)
    assert missing == []


@documents
def test_excerpts_are_what_the_file_says(document: Path) -> None:
    """A YAML block under `<!-- from FILE -->` may leave lines out; those it has stand in the file, in that order."""
    for name, excerpt in EXCERPT.findall(document.read_text()):
        lines = iter((PROJECT / name).read_text().splitlines())
        assert [line for line in excerpt.splitlines() if line.strip() and line not in lines] == [], name


PAST_OR_RUN = ("CHANGELOG.md", "own_region.md")  # the commands of the latter are run by test_own_region.py


def overrides() -> Iterator[tuple[str, str, str]]:
    """Every `--set` and `--variant` that is shown: where, the example it is for, and what the shell makes of it."""
    files = [path for path in DOCUMENTS if path.name not in PAST_OR_RUN] + sorted((PROJECT / "examples").glob("*.yaml"))
    for path in files:
        for line in path.read_text().splitlines():
            named = re.search(r"examples/\w+\.yaml", line)
            example = f"examples/{path.name}" if path.suffix == ".yaml" else "examples/peg_in_hole.yaml"
            for shown in re.findall(r"--(?:set|variant) ((?:\"[^\"]*\"|'[^']*'|[^\s`\"'])+)", line):
                if shown != "PATH=VALUE":
                    yield f"{path.relative_to(PROJECT)}", named[0] if named else example, *shlex.split(shown)


MISTAKES = ["body.stage_resolution=0.5 um/s"]  # the tutorial makes it on purpose


@pytest.mark.parametrize(("document", "example", "override"), list(overrides()))
def test_an_override_that_is_shown_fits_its_example(document: str, example: str, override: str) -> None:
    from neurorobo.config.experiment import load_experiment
    from neurorobo.errors import ConfigError
    from neurorobo.experiment.lessons import read_lessons
    from neurorobo.experiment.plan import build_plan
    from neurorobo.plugins import Registry

    registry = Registry.discover()
    with pytest.raises(ConfigError) if override in MISTAKES else nullcontext():
        experiment = load_experiment(PROJECT / example, [override], registry)
        build_plan(experiment)
        read_lessons(experiment, registry)


def test_overrides_are_shown_where_they_are_explained() -> None:
    shown = {document for document, _, _ in overrides()}
    assert {"README.md", "docs/reference/yaml.md", "docs/reference/cli.md", "docs/tutorials/first_run.md"} <= shown


def options(command: click.Command, path: str) -> Iterator[tuple[str, str]]:
    """Every command below a click command with its options, as they are typed."""
    for parameter in command.params:
        if isinstance(parameter, click.Option) and not parameter.hidden:
            yield path, max(parameter.opts, key=len)
    if isinstance(command, click.Group):
        context = click.Context(command)
        for name in command.list_commands(context):
            subcommand = command.get_command(context, name)
            assert subcommand is not None
            yield from options(subcommand, f"{path} {name}")


def test_every_command_and_option_is_documented() -> None:
    from neurorobo.cli.main import cli

    text = (PROJECT / "docs" / "reference" / "cli.md").read_text()
    words = {word for pair in options(cli, "neurorobo") for word in pair}
    assert sorted(word for word in words if f"`{word}" not in text) == []


def test_every_key_is_documented() -> None:
    from neurorobo.config.experiment import Experiment, Step
    from neurorobo.learning.phase import SupervisePhase

    for document, model in (("reference/yaml", Experiment), ("reference/yaml", Step), ("how_to/train", SupervisePhase)):
        text = (PROJECT / "docs" / f"{document}.md").read_text()
        first_column = re.findall(r"^\| ([^|]*) \|", text, re.MULTILINE)
        explained = {word for cell in first_column for word in re.findall(r"`(\w+)`", cell)}
        keys = {field.alias or name for name, field in model.model_fields.items()}
        assert sorted(keys - explained) == [], document


def test_the_plugin_of_the_guide_is_installed_runs_and_keeps_the_contract(tmp_path: Path) -> None:
    """Write the guide's files as a reader would, install them, and run its experiment and its test."""
    project, installed = tmp_path / "project", tmp_path / "installed"
    (project / "acme_brain").mkdir(parents=True)
    (project / "acme_brain" / "__init__.py").touch()
    for name, content in CAPTIONED.findall(REGION_GUIDE.read_text()):
        (project / name).write_text(content)
    offline = ["--no-index", "--no-deps", "--no-build-isolation", "--disable-pip-version-check"]
    install = [sys.executable, "-m", "pip", "install", *offline, "--target", str(installed), "."]
    run(install, project, environment(tmp_path))
    shutil.rmtree(project / "acme_brain")  # what runs is what was installed
    paths = os.pathsep.join([str(installed), *filter(None, [os.environ.get("PYTHONPATH")])])
    variables = environment(tmp_path, PYTHONPATH=paths)
    run(["neurorobo", "run", "relay.yaml", "--out", "run"], project, variables)
    figures = json.loads((project / "run" / "summary.json").read_text())["aggregate"]
    assert figures["firing_rate.relay"]["mean"] > 0.05
    assert figures["saturations"]["mean"] == 0
    run([sys.executable, "-m", "pytest", "--rootdir", str(project)], project, variables)
