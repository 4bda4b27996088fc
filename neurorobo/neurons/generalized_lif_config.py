"""The configurations of integrate-and-fire neurons by their time constants; they import no torch."""

from abc import ABC
from typing import Literal, Self

from pydantic import Field, model_validator

from neurorobo.neurons.config import NeuronConfig, SurrogateConfig, TimeConstant
from neurorobo.neurons.generalized_lif import GeneralizedLIF
from neurorobo.neurons.lif import just_above
from neurorobo.neurons.time_constants import check_time_constants, left_after, lost_after

MEMBRANE_NS = 20_000_000
SYNAPSE_NS = 5_000_000
ADAPTATION_NS = 200_000_000


class _Resetting(NeuronConfig, ABC):
    """What these neurons have in common."""

    threshold: float = Field(default=0.5, gt=0)
    reset: Literal["zero", "subtract"] = Field(
        default="zero", description="Whether a spike puts the potential to zero, or takes the threshold off it."
    )
    reset_gradient: Literal["full", "detached"] = Field(
        default="full", description="Whether the gradient flows through the reset."
    )
    surrogate: SurrogateConfig = SurrogateConfig()


class _Tying(_Resetting, ABC):
    """Those whose threshold is one number, so that a potential can be told from the next larger one."""

    fires: Literal["at", "above"] = Field(
        default="at",
        description="Whether a potential that equals the threshold fires, or only one above it; with `reset: zero`.",
    )

    @model_validator(mode="after")
    def _takes_off_what_it_fires_at(self) -> Self:
        if self.fires == "above" and self.reset == "subtract":
            raise ValueError(
                "`fires: above` has the next larger threshold, which `reset: subtract` would take off; leave out one"
            )
        return self

    def _threshold(self) -> float:
        return just_above(self.threshold) if self.fires == "above" else self.threshold


class IntegrateAndFireConfig(_Tying):
    """The integrate-and-fire neuron without a leak: it fires at a rate that is proportional to its input."""

    type: Literal["integrate_and_fire"] = "integrate_and_fire"

    def build(self, step_ns: int) -> GeneralizedLIF:
        """Return the neuron; it is the same at every step."""
        return GeneralizedLIF(
            threshold=self._threshold(),
            decay=1.0,
            reset=self.reset,
            surrogate=self.surrogate.build(),
            reset_gradient=self.reset_gradient,
        )


class _Leaking(NeuronConfig, ABC):
    """A membrane that leaks: ``membrane_time_constant dU/dt = -U + resistance I``."""

    membrane_time_constant: TimeConstant = Field(
        default=MEMBRANE_NS, description="After which 37 % of the potential are left."
    )
    resistance: float = Field(default=10.0, gt=0, description="The potential at which a constant input of one settles.")


class ExactLIFConfig(_Tying, _Leaking):
    """The leaky integrate-and-fire neuron in continuous time (Eq. 4 of Xing et al.), integrated exactly."""

    type: Literal["exact_lif"] = "exact_lif"

    def check(self, step_ns: int) -> None:
        """Raise a ValueError if the time constant is senseless at this step."""
        check_time_constants(step_ns, membrane_time_constant=self.membrane_time_constant)

    def build(self, step_ns: int) -> GeneralizedLIF:
        """Return the neuron at a step, during which its input is constant."""
        return GeneralizedLIF(
            threshold=self._threshold(),
            decay=left_after(step_ns, self.membrane_time_constant),
            input_gain=self.resistance * lost_after(step_ns, self.membrane_time_constant),
            reset=self.reset,
            surrogate=self.surrogate.build(),
            reset_gradient=self.reset_gradient,
        )


class SynapticLIFConfig(_Tying, _Leaking):
    """A leaky neuron that hears a synaptic current: what an input starts rises, and falls, exponentially."""

    type: Literal["synaptic_lif"] = "synaptic_lif"
    synaptic_time_constant: TimeConstant = Field(
        default=SYNAPSE_NS, description="After which 37 % of the synaptic current are left."
    )

    def check(self, step_ns: int) -> None:
        """Raise a ValueError if a time constant is senseless at this step."""
        check_time_constants(
            step_ns,
            membrane_time_constant=self.membrane_time_constant,
            synaptic_time_constant=self.synaptic_time_constant,
        )

    def build(self, step_ns: int) -> GeneralizedLIF:
        """Return the neuron at a step; what an input starts is the difference of two exponentials, at every step."""
        lost = lost_after(step_ns, self.membrane_time_constant) * lost_after(step_ns, self.synaptic_time_constant)
        return GeneralizedLIF(
            threshold=self._threshold(),
            decay=left_after(step_ns, self.membrane_time_constant),
            input_gain=self.resistance * lost,
            synapse_decay=left_after(step_ns, self.synaptic_time_constant),
            reset=self.reset,
            surrogate=self.surrogate.build(),
            reset_gradient=self.reset_gradient,
        )


class AdaptiveLIFConfig(_Resetting, _Leaking):
    """A leaky neuron whose threshold rises with each of its spikes and falls back (Bellec et al. 2020)."""

    type: Literal["adaptive_lif"] = "adaptive_lif"
    adaptation: float = Field(default=0.1, ge=0, description="What a spike adds to the threshold.")
    adaptation_time_constant: TimeConstant = Field(
        default=ADAPTATION_NS, description="After which 37 % of that are left."
    )

    def check(self, step_ns: int) -> None:
        """Raise a ValueError if a time constant is senseless at this step."""
        check_time_constants(
            step_ns,
            membrane_time_constant=self.membrane_time_constant,
            adaptation_time_constant=self.adaptation_time_constant,
        )

    def build(self, step_ns: int) -> GeneralizedLIF:
        """Return the neuron at a step, during which its input is constant."""
        return GeneralizedLIF(
            threshold=self.threshold,
            decay=left_after(step_ns, self.membrane_time_constant),
            input_gain=self.resistance * lost_after(step_ns, self.membrane_time_constant),
            adaptation=self.adaptation,
            adaptation_decay=left_after(step_ns, self.adaptation_time_constant),
            reset=self.reset,
            surrogate=self.surrogate.build(),
            reset_gradient=self.reset_gradient,
        )
