"""Files that commands write, and may replace."""

from pathlib import Path

from neurorobo.errors import NeuroroboError


def refuse_to_replace(out: Path, mark: str, command: str) -> None:
    """Refuse to write over anything but what an earlier call of a command has left, which begins with its mark."""
    if out.exists() and not (out.is_file() and out.read_bytes().startswith(mark.encode())):
        raise NeuroroboError(
            f"{out} exists already and was not written by `{command}`; it is left as it is: choose another place with "
            "`--out`"
        )
