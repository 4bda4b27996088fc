"""Eligibility propagation: gradients through time that no synapse has to wait for."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, ClassVar, Literal

from pydantic import Field

from neurorobo.neurons import LIF
from neurorobo.plasticity.rule import Activity, ModulatedRule, Term
from neurorobo.plasticity.traces import with_each_step

if TYPE_CHECKING:
    from torch import Tensor


class EProp(ModulatedRule):
    """How a target's firing would have changed with the weight, times a learning signal.

    What synapses would change by is ``psi[t] * trace[t]``: psi the surrogate derivative at the target's potential, the
    trace that of the source, with the decay of the target's membrane. The modulator is the learning signal, positive
    where more spikes are wanted. What flows through resets and through other neurons is left out of the gradient.
    Source: Bellec et al. 2020, e-prop for LIF neurons; with ``feedback: random``, their random e-prop.
    """

    source_traces: ClassVar[tuple[str, ...]] = ("source",)
    needs_potential: ClassVar[bool] = True

    type: Literal["eprop"] = "eprop"
    learning_rate: float = Field(ge=0, description="Multiplies all changes; nothing is learned at 0.")
    modulator: str = Field(description="The modulator that is the learning signal, of those of the region.")

    def terms(
        self, activity: Activity, traces: "Mapping[str, Tensor]"
    ) -> "tuple[Sequence[Term], Mapping[str, Tensor]]":
        """Return the eligibility of each step."""
        neuron = activity.neuron
        assert isinstance(neuron, LIF) and activity.distance is not None
        psi = neuron.surrogate.derivative(activity.distance)
        trace, after = with_each_step(activity.sources, traces["source"], neuron.decay)
        return [Term(psi, trace)], {"source": after}
