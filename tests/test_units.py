import subprocess
import sys
from decimal import Decimal
from typing import Annotated

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from neurorobo.units import (
    Duration,
    Interval,
    Unit,
    UnitError,
    format_duration,
    format_quantity,
    parse_duration_ns,
    parse_interval,
    parse_quantity,
    same_unit,
)

EXPONENTS = {"nm": -9, "um": -6, "µm": -6, "μm": -6, "mm": -3, "m": 0, "km": 3}


@pytest.mark.parametrize(
    ("text", "unit", "number"),
    [
        ("80 mN/um", "mN/um", 80.0),
        ("80 mN/um", "N/m", 80_000.0),
        ("7.8125mN", "mN", 7.8125),
        (" 0.5  um ", "um", 0.5),
        ("-1e-3 mm", "um", -1.0),
        ("+.5 mm", "um", 500.0),
        ("20 um/s^2", "m/s**2", 20e-6),
        ("3 mN * s / m", "N*s/m", 0.003),
        ("2 1/s", "Hz", 2.0),
        ("90 deg/s", "rad/s", 1.5707963267948966),
        ("50 %", "1", 0.5),
        ("3", "1", 3.0),
    ],
)
def test_a_quantity_is_read_in_the_unit_asked_for(text: str, unit: str, number: float) -> None:
    assert parse_quantity(text, unit) == number


@pytest.mark.parametrize(
    ("text", "unit", "message"),
    [
        ("5 ms", "um", "'5 ms' is a time, wanted a length such as '1 um'"),
        ("5 Hz", "rad/s", "'5 Hz' is a frequency, wanted an angular speed such as '1 rad/s'"),
        ("3 um", "1", "'3 um' is a length, wanted a plain number such as '0.5'"),
        ("2 mV", "nS", "'2 mV' is a voltage, wanted a conductance such as '1 nS'"),
        ("281 pS", "pF", "'281 pS' is a conductance, wanted a capacitance such as '1 pF'"),
        ("5 um", "N*s/m", "'5 um' is a length, wanted a quantity such as '1 N*s/m'"),
        ("5 N*s/m", "um", "'5 N*s/m' is something else, wanted a length such as '1 um'"),
        ("80", "mN/um", "'80' needs a unit, e.g. '80 mN/um'"),
        ("5 parsek", "um", "'5 parsek': 'parsek' is not a unit; wanted a length such as '1 um'"),
        ("0,5 um", "um", "'0,5 um' is not a quantity; write a number and a unit, e.g. '1 um'"),
        ("nan um", "um", "'nan um' is not a quantity; write a number and a unit, e.g. '1 um'"),
        ("", "um", "'' is not a quantity; write a number and a unit, e.g. '1 um'"),
        ("1e999 um", "um", "'1e999 um' is not a finite number"),
    ],
)
def test_what_is_not_the_quantity_asked_for_is_refused_with_the_cure(text: str, unit: str, message: str) -> None:
    with pytest.raises(UnitError) as caught:
        parse_quantity(text, unit)
    assert str(caught.value) == message


@pytest.mark.parametrize("text", ["9**9**9 um", "1 um**99", "1 __import__('os')", "1 m^(9)", "1" * 1000 + " um"])
def test_a_unit_is_never_evaluated_as_an_expression(text: str) -> None:
    with pytest.raises(UnitError, match="is not a quantity"):
        parse_quantity(text, "um")


@given(
    mantissa=st.integers(-(10**9), 10**9),
    exponent=st.integers(-9, 9),
    source=st.sampled_from(sorted(EXPONENTS)),
    target=st.sampled_from(sorted(EXPONENTS)),
)
def test_prefixes_convert_without_rounding_error(mantissa: int, exponent: int, source: str, target: str) -> None:
    exact = Decimal(mantissa).scaleb(exponent + EXPONENTS[source] - EXPONENTS[target])
    assert parse_quantity(f"{mantissa}e{exponent} {source}", target) == float(exact)


@given(number=st.floats(allow_nan=False, allow_infinity=False), unit=st.sampled_from(["um", "mN/um", "1", "deg/s"]))
@example(number=5e-324, unit="um")
def test_a_written_quantity_reads_back_to_the_same_number(number: float, unit: str) -> None:
    assert parse_quantity(format_quantity(number, unit), unit) == number


@given(st.integers(0, 2**63 - 1))
def test_a_written_duration_reads_back_to_the_same_integer(duration_ns: int) -> None:
    assert parse_duration_ns(format_duration(duration_ns)) == duration_ns


@given(st.integers(0, 10**12), st.sampled_from([("s", 9), ("ms", 6), ("us", 3), ("ns", 0)]))
def test_a_duration_is_exact_however_it_is_written(duration_ns: int, unit: tuple[str, int]) -> None:
    name, exponent = unit
    assert parse_duration_ns(f"{Decimal(duration_ns).scaleb(-exponent):f} {name}") == duration_ns


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("5", "'5' needs a unit, e.g. '5 ms'"),
        ("5 um", "'5 um' is a length, wanted a time such as '1 ms'"),
        ("-5 ms", "'-5 ms' is negative; a duration is not"),
        ("0.1 ns", "'0.1 ns' is not a whole number of nanoseconds, the finest time there is"),
        ("1e30 s", "'1e30 s' is longer than 9223372036854775807 ns, the longest time there is"),
    ],
)
def test_what_is_no_duration_is_refused_with_the_cure(text: str, message: str) -> None:
    with pytest.raises(UnitError) as caught:
        parse_duration_ns(text)
    assert str(caught.value) == message


@given(lo=st.integers(-(10**6), 10**6), hi=st.integers(-(10**6), 10**6))
def test_an_interval_rises(lo: int, hi: int) -> None:
    text = f"{lo}..{hi} um/s"
    if lo < hi:
        assert parse_interval(text, "um/s") == Interval(lo, hi)
    else:
        with pytest.raises(UnitError, match="does not rise"):
            parse_interval(text, "um/s")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("0..1", "'0..1' needs a unit, e.g. '0..1 um/s'"),
        ("5 um/s", "'5 um/s' is not a range; write e.g. '0..1 um/s'"),
        ("0..1 s", "'0 s' is a time, wanted a speed such as '1 um/s'"),
    ],
)
def test_what_is_no_interval_is_refused_with_the_cure(text: str, message: str) -> None:
    with pytest.raises(UnitError) as caught:
        parse_interval(text, "um/s")
    assert str(caught.value) == message


@pytest.mark.parametrize(
    ("first", "second", "same"),
    [
        ("mN/um", "kN/m", True),
        ("um", "µm", True),
        ("1/s", "Hz", True),
        ("mN", "N", False),
        ("um", "ms", False),
        ("Hz", "rad/s", False),
        ("1", "%", False),
    ],
)
def test_units_are_the_same_if_a_number_means_the_same_in_both(first: str, second: str, same: bool) -> None:
    assert same_unit(first, second) is same
    assert same_unit(second, first) is same


def test_an_unknown_unit_is_no_unit() -> None:
    with pytest.raises(UnitError, match="'furlongs!' is not a unit"):
        same_unit("furlongs!", "um")


class Muscle(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    stiffness: Annotated[float, Unit("mN/um", gt=0)] = 80.0
    speed: Annotated[Interval, Unit("um/s", ge=0)] = Interval(0, 100)
    share: Annotated[float, Unit("1", ge=0, le=1)] = 0.5
    lag: Duration = 200_000_000
    rest: Annotated[float, Unit("um")] | None = None
    lengths: tuple[Annotated[float, Unit("um")], ...] = ()
    slack: Annotated[float, Unit("um"), Field(lt=5)] = 1.0


def test_a_model_holds_numbers_and_dumps_texts_that_load_again() -> None:
    muscle = Muscle(stiffness="1 kN/m", speed="0..1 mm/s", share=1, lag="0.5 s", rest="1 mm", lengths=["1 um", "1 nm"])  # type: ignore[arg-type]
    assert muscle.model_dump() == {
        "stiffness": "1 mN/um",
        "speed": "0..1000 um/s",
        "share": 1.0,
        "lag": "500 ms",
        "rest": "1000 um",
        "lengths": ("1 um", "0.001 um"),
        "slack": "1 um",
    }
    assert Muscle(**muscle.model_dump()) == muscle
    assert Muscle(**Muscle().model_dump()) == Muscle()


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("stiffness", 80, "80 needs a unit, e.g. '80 mN/um'"),
        ("stiffness", "0 mN/um", "must be greater than 0 mN/um (got '0 mN/um')"),
        ("stiffness", True, "must be written like '1 mN/um'"),
        ("speed", 5, "must be written like '0..1 um/s'"),
        ("speed", "-1..1 um/s", "must be at least 0 um/s (got '-1..1 um/s')"),
        ("share", 1.5, "must be at most 1 (got 1.5)"),
        ("share", float("nan"), "'nan' is not a finite number"),
        ("share", True, "must be written like '1'"),
        ("lag", 5, "5 needs a unit, e.g. '5 ms'"),
        ("rest", "1 s", "'1 s' is a time, wanted a length such as '1 um'"),
        ("lengths", ["1 um", 2], "2 needs a unit, e.g. '2 um'"),
    ],
)
def test_a_field_refuses_what_is_not_its_quantity(field: str, value: object, message: str) -> None:
    with pytest.raises(ValidationError) as caught:
        Muscle.model_validate({field: value})
    [error] = caught.value.errors()
    assert error["msg"] == f"Value error, {message}"


def test_pydantics_own_bounds_hold_in_the_field_s_unit() -> None:
    assert Muscle.model_validate({"slack": "4000 nm"}).slack == 4
    with pytest.raises(ValidationError, match="less than 5"):
        Muscle.model_validate({"slack": "6000 nm"})


def test_unit_annotates_only_what_it_can_read() -> None:
    with pytest.raises(TypeError, match="float or Interval"):
        type("Bad", (BaseModel,), {"__annotations__": {"x": Annotated[int, Unit("um")]}})


def test_the_module_is_light_to_import() -> None:
    code = "import sys, neurorobo.clock; print(*{'pint', 'pydantic', 'numpy', 'torch'} & set(sys.modules))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split() == []
