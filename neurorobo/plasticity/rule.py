"""What a learning rule is: written once on what sources and targets did, for synapses of every kind."""

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, NamedTuple, Self, get_args

from pydantic import BaseModel, ConfigDict, Field, model_validator
from pydantic.fields import FieldInfo

from neurorobo.clock import Clock
from neurorobo.errors import Fault
from neurorobo.neurons import LIF, Neuron
from neurorobo.units import Duration, format_duration

if TYPE_CHECKING:
    from torch import Tensor


class _AtLeastOneStep:
    """Marks a time constant, which cannot be shorter than a spike step."""


TimeConstant = Annotated[Duration, _AtLeastOneStep()]
"""A time after which a trace has faded to 1/e, written ``20 ms``, held as nanoseconds; at least one spike step."""


@dataclass(frozen=True)
class Activity:
    """What both ends of synapses did in one window: spikes 0/1, ``sources`` and ``targets`` (steps, batch, neurons).

    A spike of a source counts in the step in which it arrives: at once from one layer to the next, a step later within
    a layer. A target that fires in that step fires after it. A step takes ``step_ns``. ``distance`` (steps, batch,
    targets) is how far the potential of each target is above its threshold, for rules that ask for it; ``neuron`` is
    the model of the targets.
    """

    sources: "Tensor"
    targets: "Tensor"
    step_ns: int
    neuron: Neuron
    distance: "Tensor | None" = None

    def decay(self, time_constant_ns: int) -> float:
        """Return what is left of a trace after one step."""
        return math.exp(-self.step_ns / time_constant_ns)


class Term(NamedTuple):
    """A part of a change: at each step the synapse changes by ``target`` times ``source``.

    ``target`` (steps, batch, targets) belongs to one end, ``source`` (steps, batch, sources) to the other. Where the
    rule has a modulator, a term waits for it if it is ``modulated``.
    """

    target: "Tensor"
    source: "Tensor"
    modulated: bool = True


class LearningRule(BaseModel, ABC):
    """Base of every local learning rule: what a file says of it, and a pure function of what both ends did.

    A rule is registered under the kind ``rule``; it must import torch within its methods only. ``source_traces`` and
    ``target_traces`` name what it remembers of each source and of each target, numbers that start at 0. A rule that is
    ``in_proportion`` says by what share of themselves weights change, any other one by how much. One that
    ``needs_potential`` is for LIF neurons, and is told how far these are from their thresholds.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    source_traces: ClassVar[tuple[str, ...]] = ()
    target_traces: ClassVar[tuple[str, ...]] = ()
    in_proportion: ClassVar[bool] = False
    needs_potential: ClassVar[bool] = False

    type: str
    learning_rate: float = Field(default=1.0, ge=0, description="Multiplies all changes; nothing is learned at 0.")

    @model_validator(mode="before")
    @classmethod
    def _is_no_phase(cls, value: Any) -> Any:
        if isinstance(value, Mapping) and "phase" in value:
            raise ValueError(
                "is a rule that synapses learn by while the brain runs, not a phase of training; "
                "write it under `learns` of the synapses of a `plastic_network`"
            )
        return value

    @abstractmethod
    def terms(
        self, activity: Activity, traces: "Mapping[str, Tensor]"
    ) -> "tuple[Sequence[Term], Mapping[str, Tensor]]":
        """Return by what synapses change in one window, and the traces behind it, of the same names and shapes."""

    def faults(self, clock: Clock, neuron: Neuron) -> Iterator[Fault]:
        """Yield why targets of this ``neuron`` cannot learn by the rule at the steps of this clock."""
        for name, field in type(self).model_fields.items():
            time_ns = getattr(self, name)
            if _is_time_constant(field) and time_ns is not None and time_ns < clock.spike_step_ns:
                step = format_duration(clock.spike_step_ns)
                yield Fault((name,), f"{format_duration(time_ns)} is shorter than a spike step of {step}; take more")
        if self.needs_potential and (type(neuron) is not LIF or neuron.rectify):
            yield Fault(
                ("type",),
                "needs the potential, the decay and the surrogate derivative of the neuron `lif`, and this layer has "
                "another one; take `lif`, or a rule that needs none of them",
            )


def _is_time_constant(field: FieldInfo) -> bool:
    inner = [mark for part in get_args(field.annotation) for mark in getattr(part, "__metadata__", ())]
    return any(isinstance(mark, _AtLeastOneStep) for mark in [*field.metadata, *inner])


class ModulatedRule(LearningRule):
    """Base of rules that a modulator, such as a reward, an error or a climbing fibre, can tell how much to learn.

    What the rule says is multiplied by the modulator of the same step, or with an eligibility trace e by
    ``e[t] = decay * e[t-1] + terms[t]``: synapses remember by what they would change until they are told. Sources:
    Izhikevich 2007; Fremaux & Gerstner 2016.
    """

    modulator: str | None = Field(
        default=None, description="The modulator that changes are multiplied by, of those of the region."
    )
    eligibility: TimeConstant | None = Field(
        default=None,
        description="For how long synapses remember what they did; not at all without it.",
    )
    feedback: Literal["groups", "random"] = Field(
        default="groups",
        description="How a modulator of several components reaches the neurons: one component for each group of "
        "consecutive neurons, all groups being equal; or all of them for each neuron, by fixed random weights.",
    )

    @model_validator(mode="after")
    def _has_something_to_wait_for(self) -> Self:
        if self.modulator is None and self.eligibility is not None:
            raise ValueError("an eligibility trace waits for a modulator; name one, or leave `eligibility` out")
        return self
