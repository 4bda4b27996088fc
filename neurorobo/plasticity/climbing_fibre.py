"""Plasticity of parallel fibres on Purkinje cells, taught by climbing fibres."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, ClassVar, Literal

from pydantic import Field

from neurorobo.plasticity.rule import Activity, ModulatedRule, Term, TimeConstant
from neurorobo.plasticity.traces import with_each_step

if TYPE_CHECKING:
    from torch import Tensor


class ClimbingFibre(ModulatedRule):
    """A climbing fibre weakens the parallel fibres that fired shortly before it; without one they get stronger.

    Each step adds ``ltp * source`` and takes off ``ltd * climbing * trace``, where climbing is the modulator and the
    trace that of the parallel fibre. Both balance where a cell is told ``ltp / ltd * (1 - exp(-step / tau))`` on
    average, whatever the parallel fibres do. Source: Ito 2001 for the depression; the exponential trace is ours.
    """

    source_traces: ClassVar[tuple[str, ...]] = ("source",)

    type: Literal["climbing_fibres"] = "climbing_fibres"
    modulator: str = Field(description="The modulator that the climbing fibres tell, of those of the region.")
    ltp: float = Field(ge=0, description="What a spike of a parallel fibre adds.")
    ltd: float = Field(ge=0, description="What a climbing fibre that tells 1 for a step takes off just after a spike.")
    tau: TimeConstant = Field(default=100_000_000, description="For how long a parallel fibre is held responsible.")

    def terms(
        self, activity: Activity, traces: "Mapping[str, Tensor]"
    ) -> "tuple[Sequence[Term], Mapping[str, Tensor]]":
        """Return potentiation, and depression, which waits for the climbing fibres."""
        trace, after = with_each_step(activity.sources, traces["source"], activity.decay(self.tau))
        every = activity.targets.new_ones(()).expand_as(activity.targets)
        potentiation = Term(self.ltp * every, activity.sources, modulated=False)
        return (potentiation, Term(-self.ltd * every, trace)), {"source": after}
