"""Limits of what a sensor of a body may report: as they are written, and as numbers."""

from dataclasses import dataclass
from typing import Annotated, Any, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from neurorobo.units import Duration, UnitError, parse_quantity

PositiveDuration = Annotated[Duration, Field(gt=0)]


def _has_unit(value: Any) -> Any:
    if isinstance(value, int | float) and not isinstance(value, bool):
        raise UnitError(f"{value} needs a unit, that of the sensor or one like it, e.g. '{value} N'")
    return value


Quantity = Annotated[str, BeforeValidator(_has_unit)]
"""A load or its rate as it is written: what unit it is in, the sensor says."""


@dataclass(frozen=True)
class Limits:
    """Limits as numbers, in the unit of a sensor; a limit that is None does not hold."""

    stop: float | None = None
    latch: float | None = None
    rate: float | None = None
    rate_window_ns: int = 10_000_000
    age_ns: int | None = None


class SensorLimits(BaseModel):
    """What a sensor may report before its body is stopped; each is written with a unit, as `9 N`.

    A load is the Euclidean norm of the sensor's components.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    stop: Quantity | None = Field(default=None, description="A larger load stops the body: `9 N`.")
    latch: Quantity | None = Field(
        default=None, description="A larger load stops the body until somebody has looked at it and reset it: `14 N`."
    )
    rate: Quantity | None = Field(default=None, description="A load that rises faster stops the body: `20 N/s`.")
    rate_window: PositiveDuration = Field(
        default=10_000_000, description="How far apart readings are, at least, that a rate is taken from."
    )
    age: PositiveDuration | None = Field(default=None, description="A real sensor's older reading stops the body.")

    @model_validator(mode="after")
    def _some(self) -> Self:
        if (self.stop, self.latch, self.rate, self.age) == (None, None, None, None):
            raise ValueError("limits nothing; give at least one of stop, latch, rate and age")
        return self

    def in_unit(self, unit: str) -> Limits:
        """Return the limits as numbers; a ValueError for one of another dimension, or not above 0, or out of order."""
        stop, latch = self._number("stop", unit), self._number("latch", unit)
        if stop is not None and latch is not None and latch < stop:
            raise ValueError(f"`latch: {self.latch}` is below `stop: {self.stop}`, which would never be reached")
        return Limits(stop, latch, self._number("rate", f"{unit}/s"), self.rate_window, self.age)

    def _number(self, name: str, unit: str) -> float | None:
        text: str | None = getattr(self, name)
        if text is None:
            return None
        try:
            number = parse_quantity(text, unit)
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from None
        if number <= 0:
            raise ValueError(f"{name}: must be greater than 0 {unit} (got '{text}')")
        return number
