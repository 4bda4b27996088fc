"""A dry run: the drivers of a rig talk to emulators in this process, and all that they send is shown."""

import sys
import time
from collections.abc import Callable, Iterable
from typing import Any

from stage_hardware.emulators.emulator import Emulator
from stage_hardware.rig.emulated_rig import EmulatedRig
from stage_hardware.rig.rig_config import RigConfig

Show = Callable[[str], None]


def _to_stderr(line: str) -> None:
    print(line, file=sys.stderr)


class DryRun:
    """Emulators in place of a rig's devices, from ``with``, which gives the rig at their addresses, to its end.

    Each line shown has the time since the start, the name of the controller, and what it was sent.
    """

    def __init__(self, config: RigConfig, show: Show = _to_stderr) -> None:
        """Prepare it; a NeuroroboError for a device that has no emulator."""
        self._rig, self._show = EmulatedRig(config), show

    def __enter__(self) -> RigConfig:
        """Start."""
        self._began_s = time.monotonic()
        for name, controller in self._rig.controllers.items():
            if isinstance(controller.emulator, Emulator):
                wire = controller.emulator.wire
                wire.answer = self._showing(name, wire.answer)
        self._rig.__enter__()
        return self._rig.config

    def __exit__(self, *error: Any) -> None:
        """End."""
        self._rig.__exit__(*error)

    def _showing(self, name: str, answer: Callable[[bytes], Iterable[bytes]]) -> Callable[[bytes], Iterable[bytes]]:
        def shown(came: bytes) -> Iterable[bytes]:
            text = came.decode("latin-1").encode("unicode_escape").decode("ascii")
            self._show(f"{time.monotonic() - self._began_s:9.3f} s  {name:12} {text}")
            return answer(came)

        return shown
