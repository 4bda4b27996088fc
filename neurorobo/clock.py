"""Time as integers: named periods in nanoseconds, and the steps of a spike window."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import gcd

from neurorobo.errors import ConfigError, Fault, did_you_mean
from neurorobo.units import UnitError, format_duration, parse_duration_ns

MOST_TICKS = 10_000
"""The most ticks in a hyperperiod; periods that need more are refused, as the schedule lists every tick."""


@dataclass(frozen=True)
class Clock:
    """The periods at which steps run, and the spike window of one use: ``window`` steps of ``spike_step_ns`` each.

    Every period divides the longest one, the hyperperiod, and ``control`` is the period of a step that names none. A
    ConfigError lists what does not hold, with paths such as ``("radial",)``.
    """

    periods_ns: Mapping[str, int] = field(hash=False)
    spike_step_ns: int
    window: int

    def __post_init__(self) -> None:
        """Refuse times that do not fit together."""
        object.__setattr__(self, "periods_ns", dict(self.periods_ns))
        faults = [*self._faults()]
        if faults:
            raise ConfigError(faults)

    @classmethod
    def from_config(cls, values: Mapping[str, object]) -> "Clock":
        """Read ``{control: 1 s, radial: 200 ms, spike_step: 1 ms, window: 50}``; the last two may be left out."""
        times: dict[str, int] = {}
        faults: list[Fault] = []
        window = values.get("window", 50)
        if not isinstance(window, int) or isinstance(window, bool):
            faults.append(Fault(("window",), f"must be a whole number of spike steps, e.g. 50 (got {window!r})"))
        for name, text in ({"spike_step": "1 ms"} | dict(values)).items():
            if name == "window":
                continue
            try:
                if not isinstance(text, str):
                    raise UnitError(f"must be a time such as '200 ms' (got {text!r})")
                times[name] = parse_duration_ns(text)
            except UnitError as error:
                faults.append(Fault((name,), str(error)))
        if faults:
            raise ConfigError(faults)
        assert isinstance(window, int)
        spike_step_ns = times.pop("spike_step")
        return cls(times, spike_step_ns, window)

    def to_config(self) -> dict[str, str | int]:
        """Return what `from_config` reads."""
        periods = {name: format_duration(period) for name, period in self.periods_ns.items()}
        return {**periods, "spike_step": format_duration(self.spike_step_ns), "window": self.window}

    @property
    def tick_ns(self) -> int:
        """The base tick: the largest time of which every period is a multiple."""
        return gcd(*self.periods_ns.values())

    @property
    def window_ns(self) -> int:
        """The length of a spike window."""
        return self.window * self.spike_step_ns

    def ticks(self, period: str) -> int:
        """Return the length of a named period in ticks; a ConfigError at ``("period",)`` if there is none."""
        return self._period_ns(period) // self.tick_ns

    def seconds(self, period: str) -> float:
        """Return the length of a named period in seconds; a ConfigError at ``("period",)`` if there is none."""
        return self._period_ns(period) / 1e9

    def _period_ns(self, period: str) -> int:
        if period not in self.periods_ns:
            known = did_you_mean(period, self.periods_ns)
            raise ConfigError([Fault(("period",), f"there is no period `{period}` under `time`{known}")])
        return self.periods_ns[period]

    def _faults(self) -> list[Fault]:
        if "control" not in self.periods_ns:
            return [Fault(("control",), "is missing; every brain has a control period, e.g. 'control: 1 s'")]
        times = {**self.periods_ns, "spike_step": self.spike_step_ns}
        faults = [
            Fault((name,), f"must be longer than zero (got '{format_duration(t)}')")
            for name, t in times.items()
            if t <= 0
        ]
        if self.window < 1:
            faults.append(Fault(("window",), f"must be at least 1 spike step (got {self.window})"))
        if faults:
            return faults
        longest = max(self.periods_ns, key=self.periods_ns.__getitem__)
        long_ns = self.periods_ns[longest]
        long_text = f"{longest}: {format_duration(long_ns)}"
        for name, period in self.periods_ns.items():
            if long_ns % period:
                cure = " or ".join(map(format_duration, _divisors_near(period, long_ns)))
                message = f"{format_duration(period)} does not divide {long_text}; choose e.g. {cure}"
                faults.append(Fault((name,), message))
        if not faults and long_ns // self.tick_ns > MOST_TICKS:
            shortest = min(self.periods_ns, key=self.periods_ns.__getitem__)
            message = (
                f"the periods meet on a tick of {format_duration(self.tick_ns)}, of which {long_text} holds "
                f"{long_ns // self.tick_ns}, more than {MOST_TICKS}; choose longer periods, or a shorter '{longest}'"
            )
            faults.append(Fault((shortest,), message))
        return faults


def _divisors_near(period_ns: int, whole_ns: int) -> list[int]:
    """Return the two nearest divisors of the whole, of two digits if there are such: 250 ms rather than 312500 us."""
    divisors = [whole_ns // parts for parts in range(1, MOST_TICKS + 1) if whole_ns % parts == 0]
    plain = [divisor for divisor in divisors if len(str(divisor).rstrip("0")) <= 2]
    return sorted(plain or divisors, key=lambda divisor: abs(divisor - period_ns))[:2]
