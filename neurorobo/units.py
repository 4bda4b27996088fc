"""Physical quantities in text: ``80 mN/um``, ``0..100 um/s``, ``200 ms``."""

import math
import re
from dataclasses import KW_ONLY, dataclass
from decimal import Decimal
from functools import cache
from typing import TYPE_CHECKING, Annotated, Any

from neurorobo.errors import NeuroroboError

# Imported inside the functions that need them: pint takes 0.3 s, and many a module needs only the names of this one.
if TYPE_CHECKING:
    from pint import Unit as PintUnit
    from pint import UnitRegistry
    from pydantic import GetCoreSchemaHandler
    from pydantic_core import CoreSchema

_NUMBER = r"[-+]?\d*\.?\d+(?:[eE][-+]?\d{1,3})?"
_FACTOR = r"[A-Za-zµμΩ°%_]+(?:(?:\^|\*\*)-?\d)?"
_UNIT = rf"(?:1\s*/\s*)?{_FACTOR}(?:\s*[*/ ]\s*{_FACTOR})*"
_QUANTITY = re.compile(rf"({_NUMBER})\s*({_UNIT})?")
_INTERVAL = re.compile(rf"({_NUMBER})\s*\.\.\s*({_NUMBER})\s*({_UNIT})?")
_LONGEST_TEXT = 100
_LONGEST_NS = 2**63 - 1

_DIMENSIONS = {
    "a plain number": "1",
    "a length": "um",
    "a time": "ms",
    "a force": "mN",
    "a speed": "um/s",
    "an acceleration": "um/s^2",
    "a stiffness": "mN/um",
    "a compliance": "um/mN",
    "a frequency": "Hz",
    "an angle": "deg",
    "an angular speed": "deg/s",
    "a torque": "mN*m",
    "a mass": "g",
    "a temperature": "K",
    "a voltage": "mV",
    "a current": "nA",
    "a resistance": "ohm",
    "a conductance": "nS",
    "a capacitance": "pF",
    "a pressure": "Pa",
    "a power": "W",
}


class UnitError(NeuroroboError, ValueError):
    """A text that is not the quantity that was wanted; the message quotes it and gives an example of what was."""


@dataclass(frozen=True)
class Interval:
    """The numbers from ``lo`` to ``hi``, in the unit that its annotation states."""

    lo: float
    hi: float

    def __post_init__(self) -> None:
        """Refuse an interval that does not rise."""
        if not self.lo < self.hi:
            raise UnitError(f"'{_digits(self.lo)}..{_digits(self.hi)}' does not rise; write the smaller end first")


@dataclass(frozen=True)
class Unit:
    """Pydantic annotation: ``Annotated[float, Unit("mN/um", gt=0)]`` is written ``80 mN/um``, Interval ``0..9 um/s``.

    The model holds plain numbers in ``unit``; a text in another unit of the same dimension is converted, a bare number
    refused unless ``unit`` is ``"1"``. Bounds are in ``unit`` and hold for both ends of an interval. A dump gives the
    text back.
    """

    unit: str
    _: KW_ONLY
    gt: float | None = None
    ge: float | None = None
    lt: float | None = None
    le: float | None = None

    def __get_pydantic_core_schema__(self, source: Any, handler: "GetCoreSchemaHandler") -> "CoreSchema":
        """Validate from text, serialise to text."""
        from pydantic_core import core_schema

        if source is not float and source is not Interval:
            raise TypeError(f"Unit annotates float or Interval, not {source!r}")
        return core_schema.no_info_plain_validator_function(
            self._interval if source is Interval else self._number,
            serialization=core_schema.plain_serializer_function_ser_schema(self._text),
            metadata={"pydantic_js_functions": [lambda *_: self._json_schema(source is Interval)]},
        )

    def _number(self, value: object) -> float:
        if self.unit == "1" and isinstance(value, int | float) and not isinstance(value, bool):
            number = _finite(value, str(value))
        else:
            number = parse_quantity(_as_text(value, _with_unit("1", self.unit)), self.unit)
        self._check(number, value)
        return number

    def _interval(self, value: object) -> Interval:
        interval = parse_interval(_as_text(value, _with_unit("0..1", self.unit)), self.unit)
        self._check(interval.lo, value)
        self._check(interval.hi, value)
        return interval

    def _check(self, number: float, value: object) -> None:
        for bound, holds, words in (
            (self.gt, float.__gt__, "greater than"),
            (self.ge, float.__ge__, "at least"),
            (self.lt, float.__lt__, "less than"),
            (self.le, float.__le__, "at most"),
        ):
            if bound is not None and not holds(number, float(bound)):
                shown = f"'{value}'" if isinstance(value, str) else value
                raise UnitError(f"must be {words} {format_quantity(bound, self.unit)} (got {shown})")

    def _text(self, value: float | Interval) -> str | float:
        if isinstance(value, Interval):
            return _with_unit(f"{_digits(value.lo)}..{_digits(value.hi)}", self.unit)
        return value if self.unit == "1" else format_quantity(value, self.unit)

    def _json_schema(self, interval: bool) -> dict[str, Any]:
        if interval:
            return _text_schema(_with_unit("0..1", self.unit))
        if self.unit == "1":
            bounds = {"exclusiveMinimum": self.gt, "minimum": self.ge, "exclusiveMaximum": self.lt, "maximum": self.le}
            return {"type": "number"} | {key: bound for key, bound in bounds.items() if bound is not None}
        return _text_schema(f"1 {self.unit}")


class _DurationText:
    """Pydantic annotation: an integer number of nanoseconds that is written with a unit of time."""

    def __get_pydantic_core_schema__(self, source: Any, handler: "GetCoreSchemaHandler") -> "CoreSchema":
        from pydantic_core import core_schema

        return core_schema.no_info_plain_validator_function(
            lambda value: parse_duration_ns(_as_text(value, "1 ms")),
            serialization=core_schema.plain_serializer_function_ser_schema(format_duration),
            metadata={"pydantic_js_functions": [lambda *_: _text_schema("200 ms")]},
        )


Duration = Annotated[int, _DurationText()]
"""A field of integer nanoseconds, written ``200 ms``; never negative."""


class _UnitText:
    """A validator of Pydantic's."""

    def __get_pydantic_core_schema__(self, source: Any, handler: "GetCoreSchemaHandler") -> "CoreSchema":
        from pydantic_core import core_schema

        return core_schema.no_info_after_validator_function(_known, handler(source))


def _known(unit: str) -> str:
    same_unit(unit, unit)
    return unit


KnownUnit = Annotated[str, _UnitText()]
"""A field of a configuration that names a unit; one that there is not is refused."""


def parse_quantity(text: str, unit: str) -> float:
    """Return ``text`` as a number of ``unit``; a UnitError if it is no quantity, or has no unit or another dimension.

    >>> parse_quantity("80 mN/um", "N/m")
    80000.0
    """
    return _finite(_convert(text, unit), text)


def parse_interval(text: str, unit: str) -> Interval:
    """Return the interval in ``unit`` that ``text`` states; a UnitError as for a quantity, or if it does not rise.

    >>> parse_interval("0..0.1 mm/s", "um/s")
    Interval(lo=0.0, hi=100.0)
    """
    match = _match(_INTERVAL, text)
    if match is None:
        raise UnitError(f"'{text}' is not a range; write e.g. '{_with_unit('0..1', unit)}'")
    lo, hi, written = match.groups()
    ends = (_with_unit(end, written or "1") for end in (lo, hi))
    if written is None and unit != "1":
        raise UnitError(f"'{text}' needs a unit, e.g. '{lo}..{hi} {unit}'")
    return Interval(*(parse_quantity(end, unit) for end in ends))


def parse_duration_ns(text: str) -> int:
    """Return the nanoseconds in ``text``; a UnitError if it is no time, is negative or no whole number of nanoseconds.

    >>> parse_duration_ns("0.2 s")
    200000000
    """
    duration = _convert(text, "ns", example="ms")
    if duration < 0:
        raise UnitError(f"'{text}' is negative; a duration is not")
    if duration != duration.to_integral_value():
        raise UnitError(f"'{text}' is not a whole number of nanoseconds, the finest time there is")
    if duration > _LONGEST_NS:
        raise UnitError(f"'{text}' is longer than {_LONGEST_NS} ns, the longest time there is")
    return int(duration)


def format_quantity(value: float, unit: str) -> str:
    """Return the text that `parse_quantity` reads back to the same number.

    >>> format_quantity(80.0, "mN/um")
    '80 mN/um'
    """
    return _with_unit(_digits(value), unit)


def format_duration(duration_ns: int) -> str:
    """Return whole nanoseconds in the largest unit that keeps the number whole.

    >>> format_duration(1_500_000_000)
    '1500 ms'
    """
    for unit, factor in (("s", 10**9), ("ms", 10**6), ("us", 10**3)):
        if duration_ns % factor == 0:
            return f"{duration_ns // factor} {unit}"
    return f"{duration_ns} ns"


@cache
def same_unit(first: str, second: str) -> bool:
    """Whether two units mean the same, like ``mN/um`` and ``kN/m``, unlike ``mN`` and ``N``; a UnitError if unknown."""
    registry = _registry()
    return bool(registry.get_root_units(_unit(first)) == registry.get_root_units(_unit(second)))


@cache
def _registry() -> "UnitRegistry[Decimal]":
    from pint import UnitRegistry

    return UnitRegistry(non_int_type=Decimal)


@cache
def _unit(text: str) -> "PintUnit":
    if text != "1" and not re.fullmatch(_UNIT, text):
        raise UnitError(f"'{text}' is not a unit")
    try:
        return _registry().parse_units(text)
    except AttributeError as error:  # what pint raises for a name it does not know
        raise UnitError(f"'{text}' is not a unit") from error


@cache
def _dimension(unit: "PintUnit") -> str | None:
    """Name a common dimension; root units, unlike pint's dimensions, tell an angular speed from a frequency."""
    root = _registry().get_root_units(unit)[1]
    for name, example in _DIMENSIONS.items():
        if _registry().get_root_units(_unit(example))[1] == root:
            return name
    return None


def _convert(text: str, unit: str, example: str | None = None) -> Decimal:
    """Return ``text`` in ``unit``, exactly; ``example`` is the unit to show in messages if ``unit`` is an odd one."""
    example = f"1 {example or unit}" if unit != "1" else "0.5"
    match = _match(_QUANTITY, text)
    if match is None:
        raise UnitError(f"'{text}' is not a quantity; write a number and a unit, e.g. '{example}'")
    number, written = match.groups()
    if written is None and unit != "1":
        raise UnitError(f"'{text}' needs a unit, e.g. '{number} {example.split(maxsplit=1)[1]}'")
    target = _unit(unit)
    wanted = f"{_dimension(target) or 'a quantity'} such as '{example}'"
    try:
        source = _unit(written or "1")
    except UnitError as error:
        raise UnitError(f"'{text}': '{written}' is not a unit; wanted {wanted}") from error
    registry = _registry()
    if registry.get_root_units(source)[1] != registry.get_root_units(target)[1]:
        raise UnitError(f"'{text}' is {_dimension(source) or 'something else'}, wanted {wanted}")
    return registry.Quantity(Decimal(number), source).to(target).magnitude


def _match(pattern: re.Pattern[str], text: str) -> re.Match[str] | None:
    text = text.strip()
    return pattern.fullmatch(text) if len(text) <= _LONGEST_TEXT else None


def _finite(number: float | Decimal, text: str) -> float:
    try:
        finite = float(number)
    except OverflowError:  # an integer beyond the largest float
        finite = math.inf
    if not math.isfinite(finite):
        raise UnitError(f"'{text}' is not a finite number")
    return finite


def _as_text(value: object, example: str) -> str:
    if isinstance(value, str):
        return value
    number, _, unit = example.partition(" ")
    if isinstance(value, int | float) and not isinstance(value, bool) and unit and ".." not in number:
        raise UnitError(f"{value} needs a unit, e.g. '{value} {unit}'")
    raise UnitError(f"must be written like '{example}'")


def _digits(value: float) -> str:
    return repr(float(value)).removesuffix(".0")


def _with_unit(text: str, unit: str) -> str:
    return text if unit == "1" else f"{text} {unit}"


def _text_schema(example: str) -> dict[str, Any]:
    """Return a JSON schema for editors, which need not be as exact as the parser: numbers, then perhaps a unit."""
    unit = " *[^0-9 ].*" if " " in example else ""
    return {"type": "string", "pattern": f"^[-+]?[0-9.][-+.0-9eE]*{unit}$", "examples": [example]}
