"""One axis of an emulated DS102: its settings, its drives, and the status bytes that tell of them."""

import math
from dataclasses import dataclass

from stage_hardware.emulators.mechanism import Mechanism

DIVISIONS = (1, 2, 2.5, 4, 5, 8, 10, 20, 25, 40, 50, 80, 100, 125, 200, 250)
"""Pulses per full step, by the number that `DRDIV` takes."""

FARTHEST = 99_999_999

DRIVES = ("CW", "CCW", "ORG", "HOME", "ABS", "CWJ", "CCWJ")
"""What `GO` takes, by name or number."""

NOT_CONNECTED, IN_MOTION, AT_LIMIT, EMERGENCY = "E00", "E01", "E02", "E03"


class RefusalError(Exception):
    """A command that is not carried out, for the reason of an E-code."""

    def __init__(self, code: str) -> None:
        super().__init__(code)
        self.code = code


@dataclass(frozen=True)
class Setting:
    """A number within ``lo..hi``: whole, or a distance in the unit that is set, or a fraction of it."""

    lo: float
    hi: float
    default: float
    is_distance: bool = False
    is_fraction: bool = False


SETTINGS = {
    "UNIT": Setting(0, 4, 0),
    "STANDARD": Setting(1e-6, FARTHEST, 1, is_fraction=True),
    "DRDIV": Setting(0, len(DIVISIONS) - 1, 0),
    "SELSP": Setting(0, 9, 0),
    "PULS": Setting(0, FARTHEST, 1, is_distance=True),
    "PULSA": Setting(-FARTHEST, FARTHEST, 0, is_distance=True),
    "HOMEP": Setting(-FARTHEST, FARTHEST, 0, is_distance=True),
    "CWSLE": Setting(0, 1, 0),
    "CWSLP": Setting(-FARTHEST, FARTHEST, FARTHEST, is_distance=True),
    "CCWSLE": Setting(0, 1, 0),
    "CCWSLP": Setting(-FARTHEST, FARTHEST, -FARTHEST, is_distance=True),
    "MEMSW0": Setting(0, 12, 0),
    **{f"MEMSW{number}": Setting(0, 1, 0) for number in range(1, 8)},
    **{f"L{table}": Setting(1, 9999, 100) for table in range(10)},
    **{f"F{table}": Setting(1, 999_999, 1000) for table in range(10)},
    **{f"R{table}": Setting(1, 9999, 100) for table in range(10)},
    **{f"S{table}": Setting(0, 100, 0) for table in range(10)},
}


class DS102Axis:
    """A mechanism in full steps, and what the controller makes of it in pulses.

    Clockwise is up. An axis that is not ``connected`` reads as if it ran onto both switches. ``residue`` is the count
    that is left when it has found its origin. ``keeps_origin`` lets the flag of that stand until it looks for it again
    or loses its power; otherwise it stands for as long as the axis rests there.
    """

    def __init__(self, mechanism: Mechanism, *, has_micro_steps: bool, origin_type: int, residue: int) -> None:
        """Switch it on."""
        self.mechanism, self.has_micro_steps, self.residue = mechanism, has_micro_steps, residue
        self.connected, self.keeps_origin = True, True
        self.flash = {name: setting.default for name, setting in SETTINGS.items()} | {"MEMSW0": origin_type}
        self.switch_on()

    def switch_on(self) -> None:
        """Take the settings that were written, and know of nothing else."""
        self.settings = dict(self.flash)
        self._clockwise = self._is_cut_short = self._is_shortened = self._origin_found = False
        self._origin_at: float | None = None  # the position at which it looks for its origin
        self._origin_count = 0

    @property
    def division(self) -> float:
        """Pulses per full step."""
        return DIVISIONS[int(self.settings["DRDIV"])]

    @property
    def resolution(self) -> float:
        """The distance of a pulse, in the unit that is set."""
        return self.settings["STANDARD"] / self.division if self.settings["UNIT"] else 1.0

    @property
    def count(self) -> int:
        """Where the controller believes it is, in pulses."""
        self._settle()
        return round(self.mechanism.counter * self.division)

    @property
    def moving(self) -> bool:
        """Whether a drive is under way."""
        self._settle()
        return self.mechanism.moving

    @property
    def origin_found(self) -> bool:
        """Whether it has found its origin."""
        at_rest = not self.moving
        return self._origin_found and (self.keeps_origin or (at_rest and self.count == self._origin_count))

    @property
    def at_home(self) -> bool:
        """Whether it is where `HOMEP` says."""
        return self.count == self._pulses("HOMEP")

    def set_count(self, count: int) -> None:
        """Let it believe to be there."""
        self._settle()
        self.mechanism.set_counter(count / self.division)

    def write(self, name: str, value: float) -> None:
        """Change a setting; the count stays as it is, whatever a pulse is then."""
        count = self.count
        self.settings[name] = value
        if name == "DRDIV":
            self.set_count(count)

    def go(self, drive: str) -> None:
        """Begin a drive, one of :data:`DRIVES`."""
        if not self.connected:
            raise RefusalError(NOT_CONNECTED)
        if self.moving:
            raise RefusalError(IN_MOTION)
        if drive == "ORG":
            self._seek_origin()
            return
        count, step = self.count, self._pulses("PULS")
        target = {
            "CW": count + step,
            "CCW": count - step,
            "HOME": self._pulses("HOMEP"),
            "ABS": self._pulses("PULSA"),
            "CWJ": math.inf,
            "CCWJ": -math.inf,
        }[drive]
        self._clockwise = drive in ("CW", "CWJ") if target == count else target > count
        self._is_cut_short = self._is_shortened = False
        if target == count:
            return
        if self._is_at_end(clockwise=self._clockwise):
            raise RefusalError(AT_LIMIT)
        self._take_speeds()
        target = self._shortened_by_soft_limit(target)
        if math.isinf(target):
            self.mechanism.jog(1 if self._clockwise else -1)
        else:
            self.mechanism.move_to(target / self.division)

    def stop(self, *, hard: bool) -> None:
        """End a drive."""
        if self.moving:
            self._is_cut_short, self._origin_at = True, None
            self.mechanism.stop(hard=hard)

    def sb1(self) -> int:
        """Return the status byte of drives."""
        moving = self.moving
        cw_end, ccw_end = self._soft_ends()
        bits = (
            self._clockwise,
            not self.connected or self.mechanism.at_upper_switch or self.mechanism.at_lower_switch,
            cw_end or ccw_end,
            not moving and (self._is_cut_short or self._is_shortened or self.mechanism.hit_limit),
            self.origin_found,
            self.at_home,
            moving,
        )
        return sum(1 << bit for bit, is_set in enumerate(bits) if is_set)

    def sb2(self) -> int:
        """Return the status byte of limits."""
        cw_end, ccw_end = self._soft_ends()
        bits = (
            not self.connected or self.mechanism.at_upper_switch,
            not self.connected or self.mechanism.at_lower_switch,
            cw_end,
            ccw_end,
            self.settings["CWSLE"] == 1,
            self.settings["CCWSLE"] == 1,
        )
        return sum(1 << bit for bit, is_set in enumerate(bits) if is_set)

    def _pulses(self, name: str) -> int:
        return round(self.settings[name] / self.resolution)

    def _soft_ends(self) -> tuple[bool, bool]:
        """Return whether it is at its clockwise soft limit, or beyond, and at the other."""
        count, settings = self.count, self.settings
        return (
            settings["CWSLE"] == 1 and count >= self._pulses("CWSLP"),
            settings["CCWSLE"] == 1 and count <= self._pulses("CCWSLP"),
        )

    def _is_at_end(self, *, clockwise: bool) -> bool:
        on_switch = self.mechanism.at_upper_switch if clockwise else self.mechanism.at_lower_switch
        return on_switch or self._soft_ends()[0 if clockwise else 1]

    def _speeds(self) -> tuple[float, float, float]:
        """Return start speed, speed and acceleration, in pulses per second and per second squared."""
        table = int(self.settings["SELSP"])
        fast = self.settings[f"F{table}"]
        start = min(self.settings[f"L{table}"], fast)
        return start, fast, max(fast - start, 1.0) * 1000 / self.settings[f"R{table}"]

    def _take_speeds(self) -> None:
        start, fast, acceleration = self._speeds()
        self.mechanism.start_speed, self.mechanism.speed = start / self.division, fast / self.division
        self.mechanism.acceleration = acceleration / self.division

    def _shortened_by_soft_limit(self, target: float) -> float:
        """Return where the drive ends: it begins to slow down when it comes upon a soft limit, and so runs past it."""
        way = 1 if self._clockwise else -1
        name = "CWSL" if self._clockwise else "CCWSL"
        limit = self._pulses(f"{name}P")
        if not self.settings[f"{name}E"] or way * (target - limit) <= 0:
            return target
        start, fast, acceleration = self._speeds()
        speed_squared = min(fast**2, start**2 + 2 * acceleration * abs(limit - self.count))
        end = limit + way * round((speed_squared - start**2) / (2 * acceleration))
        self._is_shortened = True
        return min(target, end) if self._clockwise else max(target, end)

    def _seek_origin(self) -> None:
        kind = int(self.settings["MEMSW0"])
        if kind == 0:
            return
        edges = {5: self.mechanism.lower_switch + 1, 6: self.mechanism.upper_switch - 1}
        self._origin_at = edges.get(kind - 6 if kind > 6 else kind, 0.0)
        self._origin_found = self._is_cut_short = self._is_shortened = False
        self._clockwise = self._origin_at > self.mechanism.position
        self._take_speeds()
        self.mechanism.move_to(self._origin_at - self.mechanism.zero)

    def _settle(self) -> None:
        """Do what is due when it has come to its origin."""
        if self._origin_at is None or self.mechanism.moving:
            return
        self._origin_found = math.isclose(self.mechanism.position, self._origin_at, abs_tol=1e-6)
        self._origin_at = None
        if self._origin_found and self.settings["MEMSW7"] == 0:
            self.mechanism.set_counter(self.residue / self.division)
        self._origin_count = round(self.mechanism.counter * self.division)
