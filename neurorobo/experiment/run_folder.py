"""The run folder: all that is needed to know what was run, and to run it again."""

import json
import platform
import subprocess
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from neurorobo.errors import NeuroroboError
from neurorobo.files import write_whole, writing

VERSIONED = ("neurorobo", "torch", "numpy", "snntorch", "gymnasium", "rerun-sdk", "pydantic")


class RunFolder:
    """A folder with all that a run was made of, and what it leaves.

    It holds ``config.yaml`` (as given), ``config.resolved.yaml`` (complete), ``run.json``, which says
    ``status: running | finished | interrupted | failed``, versions, seeds, the command if it was typed, and the times,
    and, of a run with a body, ``timing.json``: by the wall clock, how long it took from its sensors to its commands.
    """

    def __init__(self, path: Path) -> None:
        """Open a folder that exists; :meth:`create` makes a new one."""
        self.path = path

    @classmethod
    def create(
        cls,
        path: Path,
        *,
        given: str,
        resolved: str,
        seeds: Sequence[int],
        command: str | None,
        weights: Mapping[str, str],
        plugins: Mapping[str, str],
    ) -> "RunFolder":
        """Make a new folder; a NeuroroboError if it holds a run already, or cannot be written."""
        if (path / "run.json").exists():
            raise NeuroroboError(f"{path} already holds a run; give another folder with `--out`, or remove it")
        with writing(path):
            path.mkdir(parents=True, exist_ok=True)
            (path / "config.yaml").write_text(given, encoding="utf-8")
            (path / "config.resolved.yaml").write_text(resolved, encoding="utf-8")
        folder = cls(path)
        folder._write_run(
            {
                "status": "running",
                "started": _now(),
                "ended": None,
                "seeds": list(seeds),
                "command": command,
                "python": platform.python_version(),
                "platform": platform.platform(),
                "versions": {name: found for name in VERSIONED if (found := _version(name))},
                "plugins": dict(plugins),
                "weights_sha256": dict(weights),
                "git": _git_commit(),
            }
        )
        return folder

    def finish(self, status: str, error: str | None = None) -> None:
        """Note how the run ended, and of what error if of one."""
        told = {} if error is None else {"error": error}
        self._write_run({**self.run(), "status": status, "ended": _now(), **told})

    def run(self) -> dict[str, Any]:
        """Return the content of ``run.json``."""
        return self._read("run.json")

    def summary(self) -> dict[str, Any]:
        """Return the content of ``summary.json``."""
        content = self._read("summary.json")
        episodes, aggregate = content.get("episodes"), content.get("aggregate")
        if not (
            isinstance(episodes, list) and isinstance(aggregate, dict) and all(map(_is_figure, aggregate.values()))
        ):
            path = self.path / "summary.json"
            raise NeuroroboError(f"{path} is not the summary of a run; run the experiment again")
        return content

    def write_summary(self, summary: Mapping[str, Any]) -> None:
        """Write ``summary.json``."""
        write_json(self.path / "summary.json", summary)

    def write_timing(self, timing: Mapping[str, Any]) -> None:
        """Write ``timing.json``: how quickly the body was answered (:meth:`neurorobo.bodies.Body.timing`)."""
        write_json(self.path / "timing.json", timing)

    def _write_run(self, content: Mapping[str, Any]) -> None:
        write_json(self.path / "run.json", content)

    def _read(self, name: str) -> dict[str, Any]:
        path = self.path / name
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
            if not isinstance(content, dict):
                raise ValueError("it is not a mapping")
        except FileNotFoundError:
            raise NeuroroboError(f"{self.path} has no {name}: it is not the folder of a finished run") from None
        except (OSError, ValueError) as error:
            raise NeuroroboError(f"{path} cannot be read ({error}); run the experiment again") from None
        return content


def new_folder_path(base: Path, name: str, config_hash: str) -> Path:
    """Return ``<base>/<name>/<time>-<hash>``, with a counter if that second was taken."""
    stamp = datetime.now().strftime("%Y%m%d-%H%M%S")
    path = base / name / f"{stamp}-{config_hash[:8]}"
    counter = 1
    while path.exists():
        counter += 1
        path = path.with_name(f"{stamp}-{config_hash[:8]}-{counter}")
    return path


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write JSON, replacing the file at once or not at all; a NeuroroboError if it cannot be written."""
    write_whole(path, (json.dumps(content, indent=2, allow_nan=False) + "\n").encode())


def _is_figure(value: object) -> bool:
    return isinstance(value, dict) and value.keys() >= {"mean", "standard_error", "worst"}


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


def _version(distribution: str) -> str | None:
    try:
        return version(distribution)
    except PackageNotFoundError:
        return None


def _git_commit() -> str | None:
    """Return the commit of the working directory, if it is in a git work tree."""
    try:
        found = subprocess.run(["git", "rev-parse", "HEAD"], capture_output=True, text=True, timeout=5, check=True)
    except (OSError, subprocess.SubprocessError):
        return None
    return found.stdout.strip()
