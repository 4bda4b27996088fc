"""Emulates controllers in SHOT mode: SHOT-302GS, SHOT-304GS, SHOT-702, GSC-01 and GSC-02.

From what manufacturer and independent drivers publish; not compared with a device. Uncertain: which conditions are
refused, that `?:DW` of the 302GS and 304GS has the form that is known of the 702, and that a GSC-02 has no `A:`. Not
there: interpolation (`K:`, `E:`), teaching (`P:`, `B:`), HIT mode (`Z:1`); they are refused.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass

from stage_hardware.emulators.sigma_koki import DIVISIONS, SigmaKokiEmulator, Speeds
from stage_hardware.emulators.wire import Wire


@dataclass(frozen=True)
class _Model:
    axes: int
    baud: int = 9600
    acknowledges: bool = True
    is_gsc: bool = False
    fast: tuple[int, int] = (1, 500_000)
    fast_step: int = 1
    farthest: int = 999_999_999


MODELS = {
    "SHOT-302GS": _Model(2),
    "SHOT-304GS": _Model(4),
    "SHOT-702": _Model(2, baud=38400),
    "GSC-01": _Model(1, is_gsc=True, fast=(100, 20_000), fast_step=100, farthest=16_777_214),
    "GSC-02": _Model(2, is_gsc=True, acknowledges=False, fast=(1, 20_000), farthest=16_777_214),
}


class ShotEmulator(SigmaKokiEmulator):
    """A controller in SHOT mode.

    ``acknowledges`` is its memory switch ACK: MAIN (True) answers each command with OK or NG, SUB (False) answers
    queries only, as a GSC-02 always does. A ``baud`` of None stands for that of the factory.
    """

    def __init__(
        self,
        model: str = "SHOT-302GS",
        *,
        positions: Sequence[int] | None = None,
        travel: tuple[int, int] = (-20_000, 20_000),
        acknowledges: bool | None = None,
        wire: type[Wire] | None = None,
        baud: int | None = None,
        processing_s: float = 0.002,
    ) -> None:
        """Put each axis at a position, or at 200 pulses."""
        self.model, self._facts = model, MODELS[model]
        self.acknowledges = self._facts.acknowledges if acknowledges is None else acknowledges
        super().__init__(
            positions or [200] * self._facts.axes,
            travel=travel,
            wire=wire,
            baud=self._facts.baud if baud is None else baud,
            processing_s=processing_s,
        )

    def _forget(self) -> None:
        super()._forget()
        self._armed: dict[int, int] | None = None  # targets
        self._armed_jogs: dict[int, int] | None = None  # directions
        self._last_failed = False

    def _reply(self, command: str) -> str | None:
        if command == "Q:":
            return self._status()
        if command == "!:":
            return "B" if self._busy() else "R"
        if command == "I:":
            return "0"
        if command.startswith("?:") and (told := self._told(command[2:])) is not None:
            return told
        accepted = not self._takes_refusal() and self._carries_out(command)
        self._last_failed = not accepted
        if not self.acknowledges:
            return None
        return "OK" if accepted else "NG"

    def _busy(self) -> bool:
        return any(axis.moving for axis in self.axes)

    def _status(self) -> str:
        """Return counters in fields of ten columns, and three letters: refused, on a limit, busy."""
        busy = self._busy()  # before the counters: what rests is where it stays
        fields = [f"{'-' if count < 0 else ' '}{abs(count):9d}" for count in self._counts()]
        on_limit = [axis.hit_limit for axis in self.axes]
        if not any(on_limit):
            limit = "K"
        elif len(self.axes) == 1:
            limit = "L"
        elif all(on_limit):
            limit = "W"
        elif len(self.axes) == 2:
            limit = "L" if on_limit[0] else "M"
        else:
            limit = f"{sum(1 << index for index, hit in enumerate(on_limit) if hit):X}"
        return ",".join([*fields, "X" if self._last_failed else "K", limit, "B" if busy else "R"])

    def _told(self, asked: str) -> str | None:
        if asked == "V":
            return "V1.00"
        if self._facts.is_gsc:
            return None
        numbers = "".join(str(number) for number in range(1, len(self.axes) + 1))
        if (match := re.fullmatch(rf"([DBSP])([W{numbers}])", asked)) is None:
            return self.model if asked == "N" else None
        chosen = self._chosen(match[2])
        if match[1] == "S":
            return ",".join(str(self.divisions[index]) for index in chosen)
        if match[1] == "P":
            return ",".join(f"{2 / self.divisions[index]:g}" for index in chosen)
        if match[1] == "B" and self.model != "SHOT-702":
            return None
        speeds = [self.speeds[index] if match[1] == "D" else self.origin_speeds for index in chosen]
        return "".join(f"S{start}F{fast}R{ramp_ms}" for start, fast, ramp_ms in speeds)

    def _chosen(self, which: str) -> list[int]:
        return list(range(len(self.axes))) if which == "W" else [int(which) - 1]

    def _carries_out(self, command: str) -> bool:
        """Do it, or return False."""
        head, _, rest = command.partition(":")
        if head == "L":
            return self._stops(rest)
        if self._busy():
            return False
        if head == "G" and not rest:
            return self._goes()
        if self.model == "GSC-02" and head in "DH":
            return self._sets_both_speeds(rest) if head == "D" else self._seeks_origins_signed(rest)
        if head == "O":
            return rest.isdigit() and int(rest) <= 15
        match = re.fullmatch(r"([1-4W])(.*)", rest)
        if match is None or (match[1] != "W" and int(match[1]) > len(self.axes)):
            return False
        chosen, rest = self._chosen(match[1]), match[2]
        if head in ("M", "A"):
            return self._arms(head, chosen, rest)
        if head == "J":
            return self._arms_jog(chosen, rest)
        if head == "H" and not rest:
            return self._seeks_origins(chosen)
        if head == "R" and not rest:
            for index in chosen:
                self.axes[index].set_counter(0)
            return True
        if head == "C" and rest in ("0", "1"):
            for index in chosen:
                self.axes[index].motor_on = rest == "1"
            return True
        if head == "D":
            return self._sets_speeds(chosen, rest)
        if head == "V" and self.model == "SHOT-702" and len(speeds := self._speeds(rest)) == len(chosen):
            self.origin_speeds = speeds[0]
            return True
        if head == "S" and len(chosen) == 1 and rest in map(str, DIVISIONS) and not self._facts.is_gsc:
            self.divisions[chosen[0]] = int(rest)
            return True
        return False

    def _stops(self, which: str) -> bool:
        self._armed = self._armed_jogs = None
        if which not in ("W", "E", *(str(number) for number in range(1, len(self.axes) + 1))):
            return False
        for index in self._chosen(which.replace("E", "W")):
            self.axes[index].stop(hard=which == "E")
        return True

    def _arms(self, head: str, chosen: list[int], rest: str) -> bool:
        if re.fullmatch(r"([+-]P\d+)+", rest) is None or (head == "A" and self.model == "GSC-02"):
            return False
        amounts = [int(amount.replace("P", "")) for amount in re.findall(r"[+-]P\d+", rest)]
        if len(amounts) > len(chosen):
            return False
        counts = self._counts()
        targets = {
            index: amount + (counts[index] if head == "M" else 0)
            for index, amount in zip(chosen, amounts, strict=False)
        }
        if any(abs(target) > self._facts.farthest for target in targets.values()) or not self._holds(targets):
            return False
        self._armed, self._armed_jogs = targets, None
        return True

    def _arms_jog(self, chosen: list[int], rest: str) -> bool:
        if re.fullmatch(r"[+-]+", rest) is None or len(rest) != len(chosen) or not self._holds(chosen):
            return False
        directions = {index: 1 if sign == "+" else -1 for index, sign in zip(chosen, rest, strict=True)}
        self._armed, self._armed_jogs = None, directions
        return True

    def _goes(self) -> bool:
        armed, jogs = self._armed, self._armed_jogs
        self._armed = self._armed_jogs = None
        if not (armed or jogs) or not self._holds([*(armed or ()), *(jogs or ())]):
            return False
        for index, target in (armed or {}).items():
            self._move(index, target)
        for index, direction in (jogs or {}).items():
            self._jog(index, direction)
        return True

    def _seeks_origins(self, chosen: list[int]) -> bool:
        self._armed = self._armed_jogs = None
        if not self._holds(chosen):
            return False
        for index in chosen:
            self._home(index)
        return True

    def _seeks_origins_signed(self, rest: str) -> bool:
        """Home as a GSC-02, which is told a direction for each axis."""
        if re.fullmatch(r"[12][+-]|W[+-][+-]", rest) is None:
            return False
        return self._seeks_origins(self._chosen(rest[0]))

    def _sets_speeds(self, chosen: list[int], rest: str) -> bool:
        speeds = self._speeds(rest)
        if len(speeds) != len(chosen):
            return False
        low, high = self._facts.fast
        if not all(low <= speed.start and speed.fast <= high for speed in speeds):
            return False
        if not self._facts.is_gsc and any(speed.fast >= 8000 and speed.start < 64 for speed in speeds):
            return False
        step = self._facts.fast_step
        for index, (start, fast, ramp_ms) in zip(chosen, speeds, strict=True):
            self.speeds[index] = Speeds(start // step * step, fast // step * step, ramp_ms)
        return True

    def _sets_both_speeds(self, rest: str) -> bool:
        """Set speeds as a GSC-02, where the first digit is a range, not an axis."""
        speeds = self._speeds(rest[1:])
        low, high = (1, 200) if rest[:1] == "1" else (50, 20_000)
        if rest[:1] not in ("1", "2") or len(speeds) != 2:
            return False
        if not all(low <= speed.start and speed.fast <= high for speed in speeds):
            return False
        self.speeds = speeds
        return True

    @staticmethod
    def _speeds(text: str) -> list[Speeds]:
        """Return what is written, or nothing if that makes no sense."""
        if re.fullmatch(r"(S\d+F\d+R\d+)+", text) is None:
            return []
        found = [Speeds(*map(int, each)) for each in re.findall(r"S(\d+)F(\d+)R(\d+)", text)]
        return found if all(speed.start <= speed.fast and speed.ramp_ms <= 1000 for speed in found) else []

    def _holds(self, chosen: Sequence[int] | dict[int, int]) -> bool:
        return all(self.axes[index].motor_on for index in chosen)
