"""What a file of ours notes for itself, as NIR has no words for it."""

from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, ValidationInfo, model_validator

from neurorobo.clock import Clock
from neurorobo.config.plugged_reader import validation_context
from neurorobo.errors import ConfigError
from neurorobo.plugins import Registry
from neurorobo.regions.feedforward_config import CodedPort
from neurorobo.regions.spiking_network_config import Name
from neurorobo.units import format_quantity

Positive = Annotated[float, Field(gt=0, lt=3e38)]  # that single precision holds


class _Noted(BaseModel):
    model_config = ConfigDict(frozen=True, strict=True, allow_inf_nan=False)


class Quantity(_Noted):
    """A port, and which channels of the Input, or of the Output, are its own; without a code if it has no name."""

    unit: str
    width: int
    lo: float
    hi: float
    channels: tuple[int, ...] = Field(min_length=1)
    code: dict[str, Any] | None = None

    def described(self) -> dict[str, Any]:
        """Return the port in the words of an experiment."""
        return {
            "unit": self.unit,
            "width": self.width,
            "range": f"{format_quantity(self.lo, '1')}..{format_quantity(self.hi, self.unit)}",
            "code": self.code or population_uniform(len(self.channels) // self.width),
        }

    @model_validator(mode="after")
    def _is_a_port(self, info: ValidationInfo) -> Self:
        if self.width < 1:
            raise ValueError("a port is as wide as one component, or wider")
        try:
            port = CodedPort.model_validate(self.described(), context=info.context).port()
        except ValidationError as error:
            raise ValueError(_first(error)) from error
        if port.channels != len(self.channels):
            raise ValueError(f"its code has {port.channels} channels, and {len(self.channels)} are noted")
        return self


class Neurons(_Noted):
    """The neurons of a node."""

    decay: float = Field(ge=0, le=1)
    thresholds: tuple[Positive, ...]
    fires: Literal["at", "above"] = "at"


class Notes(_Noted):
    """Steps, windows, quantities, codes, exact thresholds, and whose state is kept; ``layers`` are nodes by name."""

    step_s: Positive
    spike_step: str
    window: int
    carry: Literal["never", "repeat", "always"]
    carried: tuple[str, ...]
    inputs: dict[Name, Quantity]
    outputs: dict[Name, Quantity]
    layers: dict[str, Neurons]

    @model_validator(mode="after")
    def _fits_a_clock(self) -> Self:
        try:
            Clock.from_config(self.time())
        except ConfigError as error:
            raise ValueError(str(error)) from error
        return self

    def time(self) -> dict[str, Any]:
        """Return the time of an experiment that runs the region."""
        return {"control": "1 s", "spike_step": self.spike_step, "window": self.window}


def population_uniform(neurons: int) -> dict[str, Any]:
    """Return the plainest code, in the words of an experiment."""
    return {"type": "population_uniform", "neurons": neurons}


def read_notes(text: object, registry: Registry) -> Notes | str:
    """Return the notes, or what is wrong with them."""
    try:
        return Notes.model_validate_json(text, context=validation_context(registry))  # type: ignore[arg-type]
    except ValidationError as error:
        return _first(error)


def _first(error: ValidationError) -> str:
    """Return the first fault in one line."""
    fault = error.errors(include_url=False)[0]
    return ": ".join([".".join(map(str, fault["loc"])), fault["msg"].removeprefix("Value error, ")]).removeprefix(": ")
