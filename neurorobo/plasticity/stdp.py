"""Spike-timing-dependent plasticity, of pairs and of triplets of spikes."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, ClassVar, Literal

from pydantic import Field

from neurorobo.plasticity.rule import Activity, ModulatedRule, Term, TimeConstant
from neurorobo.plasticity.traces import before_each_step, with_each_step

if TYPE_CHECKING:
    from torch import Tensor


class PairStdp(ModulatedRule):
    """A source that fires before its target strengthens the synapse, one that fires after it weakens it.

    A source that arrives a time d before its target fires, at once included, adds ``a_plus * exp(-d / tau_plus)`` to
    the weight; one that arrives d after it takes off ``a_minus * exp(-d / tau_minus)``. All pairs count. Defaults, as
    shares of the largest weight, and source: Song, Miller & Abbott 2000. With a modulator: Izhikevich 2007.
    """

    source_traces: ClassVar[tuple[str, ...]] = ("source",)
    target_traces: ClassVar[tuple[str, ...]] = ("target",)

    type: Literal["pair_stdp"] = "pair_stdp"
    a_plus: float = Field(default=0.005, description="What the closest pair adds, source first.")
    a_minus: float = Field(default=0.00525, description="What the closest pair takes off, target first.")
    tau_plus: TimeConstant = 20_000_000
    tau_minus: TimeConstant = 20_000_000

    def terms(
        self, activity: Activity, traces: "Mapping[str, Tensor]"
    ) -> "tuple[Sequence[Term], Mapping[str, Tensor]]":
        """Return potentiation and depression."""
        source, source_after = with_each_step(activity.sources, traces["source"], activity.decay(self.tau_plus))
        target, target_after = before_each_step(activity.targets, traces["target"], activity.decay(self.tau_minus))
        terms = Term(self.a_plus * activity.targets, source), Term(-self.a_minus * target, activity.sources)
        return terms, {"source": source_after, "target": target_after}


class TripletStdp(ModulatedRule):
    """Pairs whose effect grows with how lately the neuron that closes the pair had fired before.

    With the traces r of the source and o of the target: a spike of the target adds
    ``r_plus * (a2_plus + a3_plus * o_y)``, one of the source takes off ``o_minus * (a2_minus + a3_minus * r_x)``; o_y
    and r_x are those just before the spike. Defaults are those for the visual cortex, all to all, as shares of the
    weight before. Source: Pfister & Gerstner 2006, Eq. 3 and 4.
    """

    source_traces: ClassVar[tuple[str, ...]] = ("r_plus", "r_x")
    target_traces: ClassVar[tuple[str, ...]] = ("o_minus", "o_y")

    type: Literal["triplet_stdp"] = "triplet_stdp"
    a2_plus: float = Field(default=5e-10, description="What the closest pair adds, source first.")
    a3_plus: float = Field(default=6.2e-3, description="What the closest triplet of target, source, target adds.")
    a2_minus: float = Field(default=7e-3, description="What the closest pair takes off, target first.")
    a3_minus: float = Field(default=2.3e-4, description="What the closest triplet of source, target, source takes off.")
    tau_plus: TimeConstant = 16_800_000
    tau_minus: TimeConstant = 33_700_000
    tau_x: TimeConstant = Field(default=101_000_000, description="Of the source's slow trace.")
    tau_y: TimeConstant = Field(default=125_000_000, description="Of the target's slow trace.")

    def terms(
        self, activity: Activity, traces: "Mapping[str, Tensor]"
    ) -> "tuple[Sequence[Term], Mapping[str, Tensor]]":
        """Return potentiation and depression."""
        sources, targets = activity.sources, activity.targets
        r_plus, r_plus_after = with_each_step(sources, traces["r_plus"], activity.decay(self.tau_plus))
        r_x, r_x_after = before_each_step(sources, traces["r_x"], activity.decay(self.tau_x))
        o_minus, o_minus_after = before_each_step(targets, traces["o_minus"], activity.decay(self.tau_minus))
        o_y, o_y_after = before_each_step(targets, traces["o_y"], activity.decay(self.tau_y))
        terms = (
            Term(targets * (self.a2_plus + self.a3_plus * o_y), r_plus),
            Term(-o_minus, sources * (self.a2_minus + self.a3_minus * r_x)),
        )
        return terms, {"r_plus": r_plus_after, "r_x": r_x_after, "o_minus": o_minus_after, "o_y": o_y_after}
