"""The tutorial *A region of your own*, typed in a fresh environment; and a broken plugin beside the one it makes."""

import os
import re
import shlex
import subprocess
import sys
import sysconfig
import venv
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.test_documents import CAPTIONED, CONSOLE, PROJECT

PAGE = (PROJECT / "docs" / "tutorials" / "own_region.md").read_text()
COMMANDS = re.findall(r"^\$ (.+)$", "".join(CONSOLE.findall(PAGE)), re.MULTILINE)
OUTPUTS = re.findall(r"^```text\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
PROGRAMS = {"neurorobo": "neurorobo.cli.main:main", "pip": "pip:main", "pytest": "pytest:console_main"}
TRAINED_UM = 0.25
"""The rms error that is enough: a tenth of the largest move. A region that never moves has one of 1.44 um."""


@dataclass(frozen=True)
class Reader:
    """Someone who types in a folder, in an environment in which the package is installed and nothing else."""

    folder: Path
    bin: Path

    def type(self, command: str) -> str:
        """Run a command and return what it prints, or fail with that."""
        # What pip needs, setuptools, is there: it has to download nothing. (Of this option, pip reads a 0 as set.)
        offline = {"PIP_NO_INDEX": "1", "PIP_NO_DEPS": "1", "PIP_NO_BUILD_ISOLATION": "0"}
        path = os.pathsep.join([str(self.bin), os.environ["PATH"]])
        variables = {**os.environ, **offline, "PIP_DISABLE_PIP_VERSION_CHECK": "1", "PATH": path, "COLUMNS": "200"}
        done = subprocess.run(
            shlex.split(command),
            cwd=self.folder,
            env=variables,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=600,
        )
        assert done.returncode == 0, f"$ {command}\n{done.stdout}"
        return done.stdout


@pytest.fixture(scope="module")
def reader(tmp_path_factory: pytest.TempPathFactory) -> Reader:
    """Make the environment; what it lacks, such as torch, it takes from the one that runs the tests."""
    folder, environment = tmp_path_factory.mktemp("reader"), tmp_path_factory.mktemp("environment")
    venv.create(environment, symlinks=True)
    base = {"base": str(environment), "platbase": str(environment)}
    scripts, packages = (Path(sysconfig.get_path(name, "venv", base)) for name in ("scripts", "purelib"))
    (packages / "outer.pth").write_text(f"import site; site.addsitedir({sysconfig.get_path('purelib')!r})\n")
    for program, target in PROGRAMS.items():
        module, function = target.split(":")
        script = scripts / program
        lines = f"#!{scripts / 'python'}", "import sys", f"from {module} import {function}", f"sys.exit({function}())"
        script.write_text("\n".join(lines))
        script.chmod(0o755)
    for name, content in CAPTIONED.findall(PAGE):
        (folder / name).write_text(content)
    return Reader(folder, scripts)


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_of_the_tutorial_does_what_the_page_says(command: str, reader: Reader) -> None:
    printed = reader.type(command)
    if command.startswith("neurorobo new"):
        assert printed == OUTPUTS[0]
        assert sorted(re.findall(r"^\| `(my_region/\S+)`", PAGE, re.MULTILINE)) == sorted(
            str(path.relative_to(reader.folder))
            for path in reader.folder.glob("my_region/**/*.*")
            if path.suffix in (".py", ".yaml") and path.name != "__init__.py"
        )
    if command == "neurorobo plugins":
        assert OUTPUTS[1] in printed
    if command.startswith("neurorobo train"):
        (errors,) = re.findall(r"rms error move \[(.*)\]", printed)
        assert all(float(error_um) < TRAINED_UM for error_um in errors.split(","))


def test_a_broken_plugin_is_told_of_and_harms_no_other(reader: Reader) -> None:
    """The commands of the tutorial come first."""
    reader.type("neurorobo new code spilt")
    (reader.folder / "spilt" / "src" / "spilt" / "plugin.py").write_text("raise RuntimeError('coffee')\n")
    reader.type("pip install -e spilt")
    printed = reader.type("neurorobo plugins")
    assert "spilt  (spilt 0.1.0, broken)\n  failed to import: RuntimeError: coffee\n" in printed
    assert OUTPUTS[1] in printed
    reader.type("neurorobo run my_region/my_region.yaml --out undisturbed")


def test_the_environment_is_not_the_one_that_runs_the_tests(reader: Reader) -> None:
    assert reader.type("python -c 'import sys; print(sys.prefix)'").strip() not in (sys.prefix, sys.base_prefix)
