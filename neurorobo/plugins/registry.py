"""The registry: finds plugins, loads each when a name of its prefix is asked for; a broken one harms no other."""

import importlib
import os
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Literal, Protocol, get_args

from pluggy import PluginManager

import neurorobo
from neurorobo.errors import NeuroroboError, did_you_mean
from neurorobo.plugins import hookspec
from neurorobo.plugins.imports import described, import_target

GROUP = "neurorobo.plugins"
"""The entry point group; the name of an entry point is the prefix of all that its plugin registers."""

RESTRICTION = "NEUROROBO_PLUGINS"
"""The environment variable that, if set, lists the only plugins to use, separated by commas."""

Kind = Literal["region", "neuron", "code", "rule", "data", "body", "task", "recorder", "command", "device", "physics"]
KINDS: tuple[Kind, ...] = get_args(Kind)

_PREFIX = re.compile(r"[a-z][a-z0-9_]*")
_NAME = re.compile(r"[a-z][a-z0-9_]*\.[a-z][a-z0-9_]*")
_TARGET = re.compile(r"\w+(\.\w+)*:\w+")


@dataclass(frozen=True)
class Entry:
    """One registered type: ``target`` is ``package.module:attribute``, imported when it is asked for."""

    kind: Kind
    name: str
    target: str
    summary: str


@dataclass(frozen=True)
class PluginInfo:
    """What there is to tell about a plugin; ``name`` is its prefix, ``error`` why it is not loaded."""

    name: str
    distribution: str
    version: str
    status: Literal["loaded", "broken", "excluded"]
    error: str
    provides: tuple[Entry, ...]


class Registrar(Protocol):
    """What ``neurorobo_register`` receives."""

    def add(self, kind: Kind, name: str, target: str, summary: str = "") -> None:
        """Register a type: its name starts with the plugin's prefix, its target is ``package.module:attribute``."""


class Registry:
    """The types of the core and of plugins, by kind and name.

    ``Registry()`` holds the core alone, `discover` adds the installed plugins. A name without a prefix is the core's:
    ``sum`` is ``core.sum``. Nothing is imported before it is asked for.
    """

    def __init__(self) -> None:
        self._plugins: dict[str, _Plugin] = {}
        self._refused: list[PluginInfo] = []
        self._add(
            "core", "neurorobo", neurorobo.__version__, lambda: importlib.import_module("neurorobo.plugins.builtin")
        )

    @classmethod
    def discover(cls) -> "Registry":
        """Return a registry with the plugins that are installed, or those of them that ``NEUROROBO_PLUGINS`` lists.

        Raises a NeuroroboError if it lists one that is not installed.
        """
        registry = cls()
        found = sorted(entry_points(group=GROUP), key=lambda point: point.name)
        for point in found:
            registry._add_entry_point(point)
        if (listed := os.environ.get(RESTRICTION)) is not None:
            registry._restrict([name.strip() for name in listed.split(",") if name.strip()])
        return registry

    def add_plugin(self, prefix: str, plugin: object) -> None:
        """Add a plugin that is no installed package: a module or any object with hook implementations."""
        if prefix in self._plugins or not _PREFIX.fullmatch(prefix):
            raise NeuroroboError(f"a plugin cannot be called `{prefix}`: {_why_not(prefix)}")
        self._add(prefix, prefix, "", lambda: plugin)

    def get(self, kind: Kind, name: str) -> Any:
        """Return the type of that name, imported; a NeuroroboError tells what is wrong with the name or its plugin."""
        entry = self.entry(kind, name)
        try:
            return import_target(entry.target)
        except NeuroroboError as error:
            plugin = self._plugins[entry.name.partition(".")[0]]
            raise NeuroroboError(f"`{entry.name}` belongs to the plugin {plugin}: {error}") from error

    def entry(self, kind: Kind, name: str) -> Entry:
        """Return what is registered under that name without importing its target; a NeuroroboError as for `get`."""
        full_name = name if "." in name else f"core.{name}"
        plugin = self._plugins.get(full_name.partition(".")[0])
        if plugin is not None:
            plugin.load()
            if plugin.status != "loaded":
                raise NeuroroboError(f"`{name}` belongs to the plugin {plugin}, which {plugin.error}")
            if (kind, full_name) in plugin.entries:
                return plugin.entries[kind, full_name]
            for other_kind, other_name in plugin.entries:
                if other_name == full_name:
                    raise NeuroroboError(
                        f"`{name}` is a {other_kind}, not a {kind}{did_you_mean(name, self.names(kind))}"
                    )
        raise NeuroroboError(f"unknown {kind} `{name}`{did_you_mean(full_name, self.names(kind))}")

    def names(self, kind: Kind) -> tuple[str, ...]:
        """Return the names of a kind, sorted; loads every plugin and passes over the broken ones."""
        return tuple(entry.name for entry in self.entries(kind))

    def entries(self, kind: Kind) -> tuple[Entry, ...]:
        """Return what is registered of a kind, sorted by name."""
        provided = [entry for plugin in self.plugins() for entry in plugin.provides if entry.kind == kind]
        return tuple(sorted(provided, key=lambda entry: entry.name))

    def plugins(self) -> tuple[PluginInfo, ...]:
        """Load every plugin and return what there is to tell of each, the core first."""
        for plugin in self._plugins.values():
            plugin.load()
        return (*(plugin.info() for plugin in self._plugins.values()), *self._refused)

    def call(self, hook: str, **arguments: object) -> None:
        """Call a hook of every plugin; when all have been called, raise a NeuroroboError naming those that failed."""
        failures = []
        for plugin in self._plugins.values():
            plugin.load()
            if plugin.status == "loaded":
                try:
                    getattr(plugin.manager.hook, hook)(**arguments)
                except Exception as error:
                    failures.append((plugin, error))
        if failures:
            lines = (f"the plugin {plugin} failed in `{hook}`: {described(error)}" for plugin, error in failures)
            raise NeuroroboError("\n".join(lines)) from failures[0][1]

    def _add(self, prefix: str, distribution: str, version: str, find: Callable[[], object]) -> None:
        self._plugins[prefix] = _Plugin(prefix, distribution, version, find)

    def _add_entry_point(self, point: EntryPoint) -> None:
        distribution = point.dist.name if point.dist else point.value
        version = point.dist.version if point.dist else ""
        other = self._plugins.get(point.name)
        if other is not None and point.name != "core":
            # Neither is to be preferred by the order in which they were installed.
            other.break_off(
                f"cannot be told from {distribution} {version}, a plugin of the same name; uninstall one of them"
            )
        elif other is not None or not _PREFIX.fullmatch(point.name):
            error = f"cannot be called `{point.name}`: {_why_not(point.name)}"
            self._refused.append(PluginInfo(point.name, distribution, version, "broken", error, ()))
        else:
            self._add(point.name, distribution, version, point.load)

    def _restrict(self, listed: Iterable[str]) -> None:
        for name in listed:
            if name not in self._plugins:
                raise NeuroroboError(
                    f"{RESTRICTION} lists `{name}`, which is not installed{did_you_mean(name, self._plugins)}"
                )
        for name, plugin in self._plugins.items():
            if name != "core" and name not in listed:
                plugin.status, plugin.error = "excluded", f"{RESTRICTION} leaves out"
        self._refused = [info for info in self._refused if info.name in listed]


@dataclass
class _Plugin:
    """A plugin and what became of it; each has a manager of its own, so that none can fail in another's name."""

    prefix: str
    distribution: str
    version: str
    find: Callable[[], object]
    status: Literal["found", "loaded", "broken", "excluded"] = "found"
    error: str = ""
    manager: PluginManager = field(default_factory=lambda: PluginManager("neurorobo"))
    entries: dict[tuple[Kind, str], Entry] = field(default_factory=dict)

    def __str__(self) -> str:
        return f"{self.distribution} {self.version}".strip()

    def load(self) -> None:
        """Import the plugin and let it register, once; whatever goes wrong is kept in `error`."""
        if self.status != "found":
            return
        self.manager.add_hookspecs(hookspec)
        try:
            plugin = self.find()
        except (Exception, SystemExit) as error:
            self.break_off(f"failed to import: {described(error)}")
            return
        try:
            self.manager.register(plugin)
            self.manager.check_pending()
            if not self.manager.get_hookcallers(plugin):
                raise NeuroroboError(
                    "it implements no hook; decorate `neurorobo_register` with `neurorobo.plugins.hookimpl`"
                )
            self.manager.hook.neurorobo_register(registry=self)
        except (Exception, SystemExit) as error:
            self.break_off(f"failed to register: {described(error)}")
            return
        self.status = "loaded"

    def break_off(self, error: str) -> None:
        """Keep the plugin as broken; what it registered before the fault does not count."""
        self.status, self.error = "broken", error
        self.entries.clear()

    def add(self, kind: Kind, name: str, target: str, summary: str = "") -> None:
        """Register a type, refusing what would not work later or would get in another plugin's way."""
        if kind not in KINDS:
            raise NeuroroboError(f"unknown kind `{kind}` of `{name}`{did_you_mean(kind, KINDS)}")
        if not _NAME.fullmatch(name) or not name.startswith(f"{self.prefix}."):
            raise NeuroroboError(
                f"`{name}` is no name for a {kind} of this plugin; call it `{self.prefix}.<lower_case_name>`"
            )
        if not _TARGET.fullmatch(target):
            raise NeuroroboError(f"`{target}`, the target of `{name}`, is not of the form `package.module:attribute`")
        if (kind, name) in self.entries:
            raise NeuroroboError(f"the {kind} `{name}` is registered twice")
        self.entries[kind, name] = Entry(kind, name, target, summary)

    def info(self) -> PluginInfo:
        """Return what there is to tell."""
        assert self.status != "found"
        return PluginInfo(
            self.prefix, self.distribution, self.version, self.status, self.error, tuple(self.entries.values())
        )


def _why_not(prefix: str) -> str:
    return "the name is taken" if _PREFIX.fullmatch(prefix) else "a prefix is of lower case letters, digits and _"
