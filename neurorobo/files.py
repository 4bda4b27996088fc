"""Writing files: whole or not at all, and with a clear error where the system refuses."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from neurorobo.errors import NeuroroboError


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn what keeps the block from writing ``path`` (no permission, no space, ...) into a NeuroroboError."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        raise NeuroroboError(
            f"{path} cannot be written ({reason}); make room for it, or choose another place with `--out`"
        ) from error


def make_folder(path: Path) -> None:
    """Make a folder, unless it is there, and make sure that it can be written into; raises NeuroroboError."""
    with writing(path):
        path.mkdir(parents=True, exist_ok=True)
        probe = path / ".probe"
        probe.write_bytes(b"")
        probe.unlink()


def write_whole(path: Path, content: bytes) -> None:
    """Write a file and the folders that it is in, replacing what is there at once or not at all.

    Raises NeuroroboError.
    """
    unfinished = path.with_name(path.name + ".part")
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            unfinished.write_bytes(content)
            os.replace(unfinished, path)
        except BaseException:
            unfinished.unlink(missing_ok=True)
            raise
