"""A plugin to begin with: the names that it may have, and its files, rendered from templates."""

import builtins
import keyword
import os
import re
import shlex
import sys
from dataclasses import dataclass
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from string import Template
from tempfile import TemporaryDirectory

from neurorobo.errors import NeuroroboError, did_you_mean
from neurorobo.files import writing
from neurorobo.plugins import KINDS, Registry

TEMPLATES = Path(__file__).with_name("templates")
"""A folder for each kind, and `common`: files with `$`-words for :class:`string.Template`, in their names too."""

LONGEST = 19
"""Letters of a name; of a longer one, lines of the templates would be too long."""

_NAME = r"[a-z][a-z0-9]*(_[a-z0-9]+)*"
_NAMES = re.compile(rf"(?:(?P<prefix>{_NAME})\.)?(?P<name>{_NAME})")


@dataclass(frozen=True)
class Sort:
    """A kind that there are templates of: what they make, in one line, and the command for their example."""

    summary: str
    use: str


SORTS = {
    "region": Sort("answers a force with a move, through a hidden layer of spiking neurons", "train"),
    "neuron": Sort("leaky integrate-and-fire, with a threshold that rises with each spike", "run"),
    "code": Sort("the place of the spikes tells the value, one spike in each step", "run"),
    "rule": Sort("scales the synapses until every layer fires at a given rate", "train"),
    "body": Sort("a stage with one axis, simulated", "run"),
    "command": Sort("prints the ports of an experiment's regions", ""),
}
COMES_WITH = {"data": "region", "task": "body"}
"""Kinds that are of no use without another one, and are made together with it."""


@dataclass(frozen=True)
class Names:
    """The names of a plugin: its prefix, which is the package's name too, and that of what it provides."""

    prefix: str
    name: str

    @property
    def distribution(self) -> str:
        """The name that pip knows the package by."""
        return self.prefix.replace("_", "-")

    @property
    def camel(self) -> str:
        """The name of the class."""
        return "".join(part.capitalize() for part in self.name.split("_"))

    @property
    def typed(self) -> str:
        """What is typed to call it, if it is a command."""
        return self.name.replace("_", "-")


def sort_of(kind: str) -> Sort:
    """Return what there is to tell of a kind; a NeuroroboError if there are no templates of it."""
    if kind in SORTS:
        return SORTS[kind]
    if kind in COMES_WITH:
        other = COMES_WITH[kind]
        raise NeuroroboError(f"a template of `{kind}` comes with that of a {other}: `neurorobo new {other}` makes both")
    if kind in KINDS:
        raise NeuroroboError(f"there is no template of a {kind}; there are: {', '.join(SORTS)}")
    raise NeuroroboError(f"there is no kind `{kind}`{did_you_mean(kind, SORTS)}")


def read_names(kind: str, text: str, registry: Registry) -> Names:
    """Return the names in ``text``, ``name`` or ``prefix.name``; a NeuroroboError says why they cannot be taken."""
    match = _NAMES.fullmatch(text)
    if match is None:
        nearest = re.sub(r"[^a-z0-9.]+", "_", text.lower()).strip("_0123456789")
        cure = f"such as `{nearest if _NAMES.fullmatch(nearest) else f'my_{kind}'}`"
        raise NeuroroboError(
            f"`{text}` is no name for a {kind}; begin with a letter and use lower case letters, digits and _, {cure}"
        )
    names = Names(match["prefix"] or match["name"], match["name"])
    if fault := _fault(kind, names, registry):
        raise NeuroroboError(f"{fault}; choose another name")
    return names


def write_plugin(kind: str, names: Names, folder: Path) -> None:
    """Write the files of a plugin into ``folder``, which must not exist: all of them, or none.

    Raises a NeuroroboError if it exists or cannot be written.
    """
    files = rendered(kind, names)
    if os.path.lexists(folder):
        raise NeuroroboError(f"{folder} exists already, and is left as it is; choose another place with `--out`")
    with writing(folder):
        folder.parent.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(prefix=".neurorobo-new-", dir=folder.parent) as unfinished:
            project = Path(unfinished, "project")
            for path, text in files.items():
                file = project / path
                file.parent.mkdir(parents=True, exist_ok=True)
                file.write_text(text, encoding="utf-8")
            project.rename(folder)


def next_commands(kind: str, names: Names, folder: Path) -> tuple[str, str, str]:
    """Return what to type next, as a shell takes it: install the plugin in ``folder``, test it, use it."""
    return (
        shlex.join(["pip", "install", "-e", f"{folder}[test]"]),
        shlex.join(["pytest", str(folder)]),
        shlex.join(["neurorobo", _words(kind, names)["use"], str(folder / f"{names.name}.yaml")]),
    )


def rendered(kind: str, names: Names) -> dict[str, str]:
    """Return the text of each file of a plugin, by its path in the project."""
    words = _words(kind, names)
    return {
        Template(path).substitute(words): Template(text).substitute(words) for path, text in _templates(kind).items()
    }


def _words(kind: str, names: Names) -> dict[str, str]:
    """Return the words that templates hold the places of."""
    sort = sort_of(kind)
    return {
        "kind": kind,
        "prefix": names.prefix,
        "name": names.name,
        "Name": names.camel,
        "typed": names.typed,
        "distribution": names.distribution,
        "summary": sort.summary,
        "use": names.typed if kind == "command" else sort.use,
    }


def _templates(kind: str) -> dict[str, str]:
    """Return the templates of a kind by path, without the suffix that keeps tools from taking them for programs."""
    return {
        file.relative_to(folder).as_posix().removesuffix("-tpl"): file.read_text(encoding="utf-8")
        for folder in (TEMPLATES / "common", TEMPLATES / kind)
        for file in sorted(folder.rglob("*-tpl"))
    }


def _fault(kind: str, names: Names, registry: Registry) -> str | None:
    """Return why these names cannot be taken, or nothing."""
    for word in (names.prefix, names.name):
        if len(word) > LONGEST:
            return f"`{word}` is longer than {LONGEST} letters"
        if keyword.iskeyword(word) or word == "null":
            return f"`{word}` is a word of Python or YAML"
    if hasattr(builtins, names.camel):
        return f"its class would be called `{names.camel}`, which is a word of Python"
    if names.prefix in {plugin.name for plugin in registry.plugins()}:
        return f"`{names.prefix}` is the prefix of a plugin that is installed"
    if names.prefix in sys.stdlib_module_names:
        return f"`{names.prefix}` is a module of Python's own library"
    found = find_spec(names.prefix)
    if found is not None and found.origin is not None:  # a mere folder has none, and gives way to a package
        return f"`{names.prefix}` is a module that is installed"
    if _is_distribution(names.distribution):
        return f"`{names.distribution}` is a package that is installed"
    imported = re.compile(rf"^from .* import .*\b{names.camel}(Config|Phase)?\b", re.MULTILINE)
    if any(imported.search(text) for text in _templates(kind).values()):
        return f"its class would be called `{names.camel}`, as one that it needs is"
    return None


def _is_distribution(name: str) -> bool:
    try:
        metadata.distribution(name)
    except metadata.PackageNotFoundError:
        return False
    return True
