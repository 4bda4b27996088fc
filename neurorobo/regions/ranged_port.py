"""A quantity that a network has as a number, and the range in which it computes with it."""

from pydantic import BaseModel, ConfigDict, Field, ValidationInfo, field_validator

from neurorobo.units import Interval, KnownUnit, format_quantity, parse_interval


class RangedPort(BaseModel):
    """A quantity that goes in or comes out, in a range."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    unit: KnownUnit = Field(description="The unit of the quantity, such as um/s.")
    width: int = Field(default=1, ge=1, description="The number of components.")
    range: str = Field(description="What the network computes with as -1..1, such as 0..100 um/s.")

    @field_validator("range")
    @classmethod
    def _in_unit(cls, text: str, info: ValidationInfo) -> str:
        if (unit := info.data.get("unit")) is None:
            return text
        interval = parse_interval(text, unit)
        return f"{format_quantity(interval.lo, '1')}..{format_quantity(interval.hi, unit)}"

    @property
    def interval(self) -> Interval:
        """The range, in the unit of the port."""
        return parse_interval(self.range, self.unit)
