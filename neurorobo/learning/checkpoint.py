"""Checkpoints: the state of an unfinished training phase on disk, with what it belongs to and the time it took."""

import json
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from neurorobo.errors import NeuroroboError
from neurorobo.files import write_whole


@dataclass
class Checkpoints:
    """The checkpoint of one phase in ``file``, written again every ``every_s`` seconds.

    ``after`` is the SHA-256 of the weights file that the phase goes on from, or nothing; a checkpoint that went on from
    another one is refused. The file is safetensors, with a JSON text in its header.
    """

    file: Path
    every_s: float = 60.0
    after: str = ""
    _before_s: float = field(default=0.0, init=False)
    _started: float = field(default_factory=time.monotonic, init=False)
    _written: float = field(default_factory=time.monotonic, init=False)

    @property
    def seconds(self) -> float:
        """How long the phase has taken by now: the time before the checkpoint that was loaded, and all since."""
        return self._before_s + time.monotonic() - self._started

    @property
    def due(self) -> bool:
        """Whether it is time to write."""
        return time.monotonic() - self._written >= self.every_s

    def write(self, done: int, tensors: Mapping[str, Tensor], belongs: Mapping[str, Any]) -> None:
        """Write the state after ``done`` steps; ``belongs``, ready for JSON, tells what it is the state of.

        Raises NeuroroboError if the file cannot be written.
        """
        header = {"done": done, "seconds": self.seconds, "after": self.after, "belongs": belongs}
        content = save({name: t.contiguous() for name, t in tensors.items()}, {"checkpoint": json.dumps(header)})
        write_whole(self.file, content)
        self._written = time.monotonic()

    def read(self, belongs: Mapping[str, Any]) -> tuple[int, dict[str, Tensor]] | None:
        """Return the steps done and the state, or nothing if there is no file; the time goes on from the file's.

        Raises NeuroroboError if the file is no checkpoint, or does not belong to the same things.
        """
        self._started = self._written = time.monotonic()
        if not self.file.exists():
            return None
        try:
            with safe_open(self.file, "pt") as opened:
                header = json.loads(opened.metadata()["checkpoint"])
                tensors = {name: opened.get_tensor(name) for name in opened.keys()}  # noqa: SIM118 (not a mapping)
            done, before_s = int(header["done"]), float(header["seconds"])
            found = {"the weights of the phase before": header["after"], **header["belongs"]}
        except (SafetensorError, OSError, KeyError, TypeError, ValueError) as error:
            raise NeuroroboError(f"{self.file} is not a checkpoint ({error}); remove it to start afresh") from error
        wanted = {"the weights of the phase before": self.after, **belongs}
        # Through JSON, as what was read has been.
        if changed := [name for name in wanted if found.get(name) != json.loads(json.dumps(wanted[name]))]:
            raise NeuroroboError(
                f"{self.file} belongs to another training: {' and '.join(changed)} differ; remove it to start this "
                "phase afresh, or train as before"
            )
        self._before_s = before_s
        return done, tensors
