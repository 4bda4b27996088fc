"""Homeostasis: a neuron that fires too much has its synapses scaled down, one that fires too little up."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from pydantic import Field

from neurorobo.plasticity.rule import Activity, LearningRule, Term, TimeConstant
from neurorobo.plasticity.traces import with_each_step
from neurorobo.units import Unit

if TYPE_CHECKING:
    from torch import Tensor


class SynapticScaling(LearningRule):
    """All synapses of a target change in proportion to themselves, until it fires at the ``rate``.

    ``dw/dt = learning_rate * w * (rate - average)``, with the running average, of the time constant ``tau``, of the
    target's spikes. It is meant for synapses that excite. Source: van Rossum, Bi & Turrigiano 2000, who also add the
    integral of the difference, which is left out here.
    """

    target_traces: ClassVar[tuple[str, ...]] = ("excess",)
    in_proportion: ClassVar[bool] = True

    type: Literal["synaptic_scaling"] = "synaptic_scaling"
    learning_rate: float = Field(ge=0, description="What share of itself a weight changes by, per second and Hz.")
    rate: Annotated[float, Unit("Hz", ge=0)] = Field(description="The firing rate of each target that is wanted.")
    tau: TimeConstant = Field(default=1_000_000_000, description="Over which the firing is averaged.")

    def terms(
        self, activity: Activity, traces: "Mapping[str, Tensor]"
    ) -> "tuple[Sequence[Term], Mapping[str, Tensor]]":
        """Return what the average is short of the rate, in spikes per step, alike for all sources."""
        decay = activity.decay(self.tau)
        too_many = activity.targets - self.rate * activity.step_ns * 1e-9
        excess, after = with_each_step((1 - decay) * too_many, traces["excess"], decay)
        return [Term(-excess, activity.sources.new_ones(()).expand_as(activity.sources))], {"excess": after}
