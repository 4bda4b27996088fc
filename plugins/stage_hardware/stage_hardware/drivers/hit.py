"""Drives controllers in HIT mode: HSC-103, HIT-M and SHRC-203.

Protocol: the manufacturer's sample for the HSC-103, C# class and Micro-Manager adapter. Not tried on a device.
Uncertain: what an HIT-M calls itself (so it is told by its number of axes only), the motor command `C:` in this mode,
and how limit switches are told; here an axis that rests short of its target has lost its reference, whatever it met.
"""

import time
from collections.abc import Mapping
from dataclasses import dataclass

from stage_hardware.drivers.sigma_koki import Reading, SigmaKokiAxis, SigmaKokiStage, SpeedRange
from stage_hardware.errors import HardwareError
from stage_hardware.links.serial_link import SerialLink

SPEEDS = SpeedRange(1, 4_000_000)


@dataclass(frozen=True)
class HitController:
    """What sets a model apart; one that has no ``told_name`` is not asked for it."""

    name: str
    connectors: int
    told_name: str | None = None
    has_formats: bool = False


HSC_103 = HitController("HSC-103", 3, "HSC-103")
HIT_M = HitController("HIT-M", 8)
SHRC_203 = HitController("SHRC-203", 3, "SHRC-203", has_formats=True)


class HitStage(SigmaKokiStage):
    """A controller in HIT mode, whose axes move independently of one another.

    An HSC-103 counts 100 pulses per um. The controllers want RTS/CTS. Speeds cannot be read back.
    """

    like_no_other = "?:N", "(?!OK$).*[A-Z].*"

    def __init__(
        self,
        name: str,
        url: str,
        axes: Mapping[str, SigmaKokiAxis],
        *,
        controller: HitController = HSC_103,
        baud: int = 38400,
        hardware_flow_control: bool = True,
        timeout_s: float = 0.5,
    ) -> None:
        """Name the line as for a SerialLink, and the axes; a ValueError for one that does not fit."""
        link = SerialLink(
            name,
            url,
            baud=baud,
            ends=b"\r\n",
            reply_ends=b"\r\n",
            hardware_flow_control=hardware_flow_control,
            timeout_s=timeout_s,
        )
        super().__init__(name, axes, link, controller.connectors)
        self.controller = controller
        self.speeds = {key: SPEEDS.speeds(key, axis) for key, axis in axes.items()}
        if any(axis.division is not None for axis in axes.values()) and not controller.has_formats:
            raise ValueError(f"{controller.name} does not let one set a division")

    def _identify(self) -> None:
        if self.controller.told_name is not None:
            told = self._ask("?:N").replace(" ", "")
            if told != self.controller.told_name:
                raise HardwareError(
                    self.name,
                    f"it calls itself {told!r}, not {self.controller.told_name!r}",
                    "name the controller that it is",
                )
        if self.controller.has_formats and self._ask("?:FMT") != "HIT":
            self._order("FMT:HIT", self.link.stops)

    def _set_up(self) -> None:
        stops = self.link.stops
        divisions = {axis.number: axis.division for axis in self._axes.values() if axis.division is not None}
        if divisions:
            self._order(f"S:{self._fields(divisions)}", stops)
        for key, axis in self._axes.items():
            self._order(f"D:{axis.number},{','.join(map(str, self.speeds[key]))}", stops)

    def _has_lost_settings(self) -> bool:
        return False

    def _read(self) -> Reading:
        """Ask `!:` and then `Q:`, so that the counts of axes that rest are those at which they rest."""
        busy = self._numbers("!:")
        if not set(busy) <= {0, 1}:
            raise self._makes_no_sense(",".join(map(str, busy)), "!:")
        counts = self._numbers("Q:")
        return Reading(time.monotonic_ns(), counts, tuple(map(bool, busy)), (False,) * len(counts))

    def _numbers(self, command: str) -> tuple[int, ...]:
        reply = self._ask(command)
        numbers = self._integers(reply.split(","), reply, command)
        if len(numbers) != self.controller.connectors:
            raise self._makes_no_sense(reply, command)
        return numbers

    def _start_moves(self, counts: Mapping[str, int], stops: int) -> None:
        self._order(f"A:{self._fields({self._axes[name].number: count for name, count in counts.items()})}", stops)

    def _start_homing(self, axes: list[str], stops: int) -> list[str]:
        self._order(f"H:{self._fields({self._axes[name].number: 1 for name in axes})}", stops)
        return axes

    def _energise_command(self, on: bool) -> str:
        return f"C:{self._fields({axis.number: int(on) for axis in self._axes.values()})}"

    def _fields(self, values: Mapping[int, int]) -> str:
        """Return values by axis; those of other axes are left empty."""
        return ",".join(str(values.get(number, "")) for number in range(1, self.controller.connectors + 1))
