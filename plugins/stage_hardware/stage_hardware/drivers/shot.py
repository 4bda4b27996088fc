"""Drives controllers in SHOT mode: SHOT-302GS, SHOT-304GS, SHOT-702, GSC-01 and GSC-02.

Protocol: the manufacturer's SigmaKokiPy, C# class and Micro-Manager adapter, manual texts of GSC-01 and GSC-02, and
drivers of others. Not tried on a device. Uncertain: that 302GS and 304GS answer `?:DW` in the form that is known of the
702, that every command but a stop is refused while an axis moves, and that no limit is told after an origin was found.
A GSC-02 is given relative moves, worked out from a count that was read just before, as it may have no absolute ones.
"""

import re
import time
from collections.abc import Mapping
from dataclasses import dataclass

from stage_hardware.drivers.sigma_koki import Reading, SigmaKokiAxis, SigmaKokiStage, SpeedRange, Speeds
from stage_hardware.errors import HardwareError, RefusedError, ReplyTimeoutError
from stage_hardware.links.serial_link import SerialLink

FIELD = 10
"""Columns of a count: a sign, and nine for the digits."""


@dataclass(frozen=True)
class ShotController:
    """What sets a model apart: connectors, speeds, and what it understands."""

    name: str
    connectors: int
    baud: int
    speeds: SpeedRange
    farthest: int = 999_999_999
    acknowledges: bool = True
    tells_settings: bool = True
    is_gsc_02: bool = False


SHOT_302GS = ShotController("SHOT-302GS", 2, 9600, SpeedRange(1, 500_000))
SHOT_304GS = ShotController("SHOT-304GS", 4, 9600, SpeedRange(1, 500_000))
SHOT_702 = ShotController("SHOT-702", 2, 38400, SpeedRange(1, 500_000))
GSC_01 = ShotController("GSC-01", 1, 9600, SpeedRange(100, 20_000, 100), 16_777_214, tells_settings=False)
GSC_02 = ShotController(
    "GSC-02",
    2,
    9600,
    SpeedRange(1, 20_000),
    16_777_214,
    acknowledges=False,
    tells_settings=False,
    is_gsc_02=True,
)


class ShotStage(SigmaKokiStage):
    """A controller in SHOT mode; none of its axes can begin a motion while another one moves.

    ``acknowledges`` is its memory switch ACK: MAIN (True) or SUB (False); by default what the factory sets. Without
    acknowledgement each command is followed by a query, which takes longer. The controllers want RTS/CTS.
    """

    begins_while_moving = False
    like_no_other = "!:", "[BR]"

    def __init__(
        self,
        name: str,
        url: str,
        axes: Mapping[str, SigmaKokiAxis],
        *,
        controller: ShotController = SHOT_302GS,
        baud: int | None = None,
        hardware_flow_control: bool = True,
        acknowledges: bool | None = None,
        timeout_s: float = 0.5,
    ) -> None:
        """Name the line as for a SerialLink, and the axes; a ValueError for one that does not fit."""
        link = SerialLink(
            name,
            url,
            baud=baud or controller.baud,
            ends=b"\r\n",
            reply_ends=b"\r\n",
            hardware_flow_control=hardware_flow_control,
            timeout_s=timeout_s,
        )
        super().__init__(name, axes, link, controller.connectors)
        self.controller = controller
        self.acknowledges = controller.acknowledges if acknowledges is None else acknowledges
        self.tells_settings, self.stop_replies = controller.tells_settings, int(self.acknowledges)
        self.speeds = {key: controller.speeds.speeds(key, axis) for key, axis in axes.items()}
        for key, axis in axes.items():
            farthest = max(abs(axis.pulses(axis.axis.lo)), abs(axis.pulses(axis.axis.hi)))
            if farthest > controller.farthest:
                raise ValueError(
                    f"axis {key} would go to pulse {farthest}, and {controller.name} counts to {controller.farthest}"
                )
            if axis.division is not None and not controller.tells_settings:
                raise ValueError(f"axis {key} has a division, which {controller.name} does not let one set")
        if controller.is_gsc_02 and self._is_fast() and any(speeds.start < 50 for speeds in self.speeds.values()):
            raise ValueError("axes of a GSC-02 have start speeds from 50 pulses per second, or no speed above 200")

    def _identify(self) -> None:
        reading = self._read()
        if len(reading.counts) != self.controller.connectors:
            raise HardwareError(
                self.name,
                f"it tells of {len(reading.counts)} axes, and is no {self.controller.name}",
                "name the controller that it is",
            )

    def _set_up(self) -> None:
        stops = self.link.stops
        for key, axis in self._axes.items():
            if axis.division is not None:
                self._order(f"S:{axis.number}{axis.division}", stops)
            start, fast, ramp_ms = self.speeds[key]
            if not self.controller.is_gsc_02:
                self._order(f"D:{axis.number}S{start}F{fast}R{ramp_ms}", stops)
        if self.controller.is_gsc_02:
            by_number = {axis.number: self.speeds[key] for key, axis in self._axes.items()}
            both = [by_number.get(number, next(iter(by_number.values()))) for number in (1, 2)]
            written = "".join(f"S{start}F{fast}R{ramp_ms}" for start, fast, ramp_ms in both)
            self._order(f"D:{2 if self._is_fast() else 1}{written}", stops)
        if self.tells_settings and self._has_lost_settings():
            raise HardwareError(
                self.name,
                "speeds or divisions are not what was written",
                "see whether its panel or another client sets them",
            )

    def _is_fast(self) -> bool:
        return any(speeds.fast > 200 for speeds in self.speeds.values())

    def _has_lost_settings(self) -> bool:
        reply = self._ask("?:DW")
        told = [Speeds(*map(int, each)) for each in re.findall(r"S(\d+)F(\d+)R(\d+)", reply)]
        if len(told) != self.controller.connectors:
            raise self._makes_no_sense(reply, "?:DW")
        if any(told[axis.number - 1] != self.speeds[key] for key, axis in self._axes.items()):
            return True
        if all(axis.division is None for axis in self._axes.values()):
            return False
        reply = self._ask("?:SW")
        divisions = self._integers(reply.split(","), reply, "?:SW")
        if len(divisions) != self.controller.connectors:
            raise self._makes_no_sense(reply, "?:SW")
        return any(axis.division not in (None, divisions[axis.number - 1]) for axis in self._axes.values())

    def _read(self) -> Reading:
        """Ask `Q:`; its columns are fixed: ten for each count, and then three letters."""
        reply = self._ask("Q:")
        time_ns = time.monotonic_ns()
        axes, rest = divmod(len(reply) - 5, FIELD + 1)
        if rest or axes < 1 or re.fullmatch(r",[XK],[0-9A-FKLMW],[BR]", reply[-6:]) is None:
            raise self._makes_no_sense(reply, "Q:")
        fields = [reply[start : start + FIELD] for start in range(0, axes * (FIELD + 1), FIELD + 1)]
        if not all(re.fullmatch(r" *-? *\d+", field) for field in fields):
            raise self._makes_no_sense(reply, "Q:")
        counts = self._integers(fields, reply, "Q:")
        busy = reply[-1] == "B"
        numbers_sent = {self._axes[name].number for name in self._sent} or set(range(1, axes + 1))
        return Reading(
            time_ns,
            counts,
            tuple(busy and number in numbers_sent for number in range(1, axes + 1)),
            self._on_limit(reply[-3], axes),
            refused=reply[-5] == "X",
        )

    @staticmethod
    def _on_limit(letter: str, axes: int) -> tuple[bool, ...]:
        """Return which axes a letter says to be on a limit switch: up to two have letters, more of them bits."""
        if letter in "KW":
            return (letter == "W",) * axes
        if axes <= 2:
            return (letter == "L", letter == "M")[:axes]
        return tuple(bool(int(letter, 16) >> index & 1) for index in range(axes))

    def _order(self, command: str, stops: int) -> None:
        if self.acknowledges:
            try:
                return super()._order(command, stops)
            except ReplyTimeoutError as error:
                raise ReplyTimeoutError(
                    self.name, error.fault, f"{error.cure}, and that its switch ACK stands at MAIN"
                ) from error
        self.link.send(command, stops=stops)
        if self._read().refused:
            raise self._refused(command)

    def _must_look_before_it_moves(self, targets: Mapping[str, float]) -> bool:
        return self.controller.is_gsc_02 or 1 < len(targets) < self.controller.connectors

    def _start_moves(self, counts: Mapping[str, int], stops: int) -> None:
        by_number = {self._axes[name].number: count for name, count in counts.items()}
        letter = "A"
        if self._must_look_before_it_moves(counts):
            reading = self._reading
            if any(reading.busy):
                raise RefusedError(self.name, "it moves", "wait until it rests")
            here = dict(enumerate(reading.counts, start=1))
            if self.controller.is_gsc_02:
                letter, by_number = "M", {number: count - here[number] for number, count in by_number.items()}
                here = dict.fromkeys(here, 0)
            if len(by_number) > 1:
                by_number = here | by_number
        which = "W" if len(by_number) > 1 else str(next(iter(by_number)))
        amounts = "".join(
            f"{by_number[number]:+d}".replace("+", "+P").replace("-", "-P") for number in sorted(by_number)
        )
        self._order(f"{letter}:{which}{amounts}", stops)
        self._order("G:", stops)

    def _start_homing(self, axes: list[str], stops: int) -> list[str]:
        """Look for all origins at once if there are no other axes, or for the first."""
        begun = axes if len(axes) == self.controller.connectors > 1 else axes[:1]
        numbers = sorted((self._axes[name].number, self._axes[name].seeks_origin) for name in begun)
        which = "W" if len(begun) > 1 else str(numbers[0][0])
        signs = "".join("+" if sign > 0 else "-" for _, sign in numbers) if self.controller.is_gsc_02 else ""
        self._order(f"H:{which}{signs}", stops)
        return begun

    def _energise_command(self, on: bool) -> str:
        return f"C:{'1' if self.controller.connectors == 1 else 'W'}{int(on)}"
