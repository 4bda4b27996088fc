"""The configuration of a supervised phase, and of the data it draws."""

import math
from collections.abc import Callable, Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from neurorobo.errors import ConfigError, Fault, did_you_mean
from neurorobo.regions.port import Port
from neurorobo.units import UnitError, parse_quantity

_FALL: Mapping[str, Callable[[float], float]] = {
    "constant": lambda done: 1.0,
    "linear": lambda done: 1.0 - done,
    "cosine": lambda done: (1.0 + math.cos(math.pi * done)) / 2.0,
}


def _as_text(value: object) -> object:
    """Let a dimensionless error be written as a number; one with a unit is text."""
    return str(value) if isinstance(value, int | float) and not isinstance(value, bool) else value


class DataConfig(BaseModel):
    """Base of the configuration of a source of training data; it must not import torch.

    ``implementation`` names the class behind it, as ``"package.module:Class"``: built from the configuration and the
    clock, it is a :class:`neurorobo.learning.supervise.Data`.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    implementation: ClassVar[str]

    type: str


class Unroll(BaseModel):
    """An outer recurrence to train through: the region runs ``windows`` times, and so does its teacher.

    Before each further window the outputs named in ``feedback`` become inputs; the other inputs stay as they are. The
    loss of window i counts ``discount**i``, i = 0, 1, ...
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    windows: int = Field(ge=1)
    feedback: dict[str, str] = Field(
        default={}, description="The output port that each input port takes its next value from."
    )
    discount: float = Field(default=1.0, gt=0, le=1)


class SupervisePhase(BaseModel):
    """Train a region to do what its teacher does, by back-propagation through time with surrogate gradients (STBP).

    Source: Eq. 9 and 10 of Xing et al. for the loss and the unrolling, Wu et al. 2018 for the gradients.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    phase: Literal["supervise"] = "supervise"
    region: str
    teacher: str | dict[str, Any] = Field(description="A region with numeric ports, which gives the desired outputs.")
    data: str | dict[str, Any] = Field(description="Where the inputs of both come from.")
    loss: dict[str, Annotated[str, BeforeValidator(_as_text)]] = Field(
        min_length=1, description="The outputs that are taught, each with the error that counts as one: {move: 0.1 um}."
    )
    train: tuple[str, ...] | None = Field(default=None, description="The parameter groups to train; all if left out.")
    freeze: tuple[str, ...] = Field(default=(), description="Parameter groups to leave as they are.")
    unroll: Unroll = Unroll(windows=1)
    steps: int = Field(ge=1)
    batch: int = Field(default=32, ge=1)
    learning_rate: float = Field(
        default=0.02, gt=0, description="Adam's, for a fan-in of one; other weights get it divided by its root."
    )
    schedule: Literal["constant", "linear", "cosine"] = Field(
        default="cosine", description="How the learning rate goes on from its peak: it stays, or falls to zero."
    )
    warmup: int = Field(default=20, ge=0, description="Steps in which the learning rate rises to its peak.")
    rate_penalty: float = Field(default=0.0, ge=0, description="What a mean firing rate of one would add to the loss.")
    precision: Literal["bf16", "float32"] = Field(
        default="float32", description="The products of spikes and weights while training; sums are always float32."
    )
    seed: int = Field(default=0, ge=0)

    def check(self, inputs: Mapping[str, Port], outputs: Mapping[str, Port]) -> None:
        """Raise a ConfigError with all that does not fit a region of these ports."""
        faults = [*self._loss_faults(outputs)]
        for target, source in self.unroll.feedback.items():
            path = ("unroll", "feedback", target)
            if target not in inputs:
                faults.append(Fault(path, f"`{self.region}` has no input `{target}`{did_you_mean(target, inputs)}"))
            elif source not in outputs:
                faults.append(Fault(path, f"`{self.region}` has no output `{source}`{did_you_mean(source, outputs)}"))
            elif (inputs[target].unit, inputs[target].width) != (outputs[source].unit, outputs[source].width):
                faults.append(Fault(path, f"input `{target}` and output `{source}` differ in unit or width"))
        if faults:
            raise ConfigError(faults)

    def unit_errors(self, outputs: Mapping[str, Port]) -> dict[str, float]:
        """Return the error that counts as one for each taught output, in the unit of its port."""
        return {name: parse_quantity(text, outputs[name].unit) for name, text in self.loss.items()}

    def learning_rate_at(self, step: int) -> float:
        """Return the learning rate of a step."""
        done = step / self.steps
        rise = min(1.0, (step + 1) / self.warmup) if self.warmup else 1.0
        return self.learning_rate * rise * _FALL[self.schedule](done)

    def _loss_faults(self, outputs: Mapping[str, Port]) -> list[Fault]:
        faults = []
        for name, text in self.loss.items():
            path = ("loss", name)
            if name not in outputs:
                faults.append(Fault(path, f"`{self.region}` has no output `{name}`{did_you_mean(name, outputs)}"))
                continue
            try:
                if parse_quantity(text, outputs[name].unit) <= 0:
                    faults.append(Fault(path, f"the error that counts as one must be above zero (got '{text}')"))
            except UnitError as error:
                faults.append(Fault(path, str(error)))
        return faults
