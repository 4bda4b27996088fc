"""The hooks that a plugin may implement: functions of these names, decorated with `hookimpl`, in its plugin module."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pluggy import HookimplMarker, HookspecMarker

if TYPE_CHECKING:
    from neurorobo.plugins.registry import Registrar

hookspec = HookspecMarker("neurorobo")
hookimpl = HookimplMarker("neurorobo")


@hookspec
def neurorobo_register(registry: "Registrar") -> None:
    """Register types by calling ``registry.add``; import nothing heavy here, targets are strings."""


@hookspec
def neurorobo_run_started(folder: Path) -> None:
    """Called when the folder of a run exists and its resolved configuration is in it."""


@hookspec
def neurorobo_run_finished(folder: Path, summary: Mapping[str, Any]) -> None:
    """Called when a run has ended and its summary is in the folder."""
