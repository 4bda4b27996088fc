"""The plastic synapses of one projection: what rules say of them, summed over a window, and within which bounds."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from neurorobo.plasticity.rule import Activity, LearningRule, ModulatedRule, Term
from neurorobo.units import Interval

CHANGE = "change"
"""The name in the state of what synapses have learned; the rest of it fades."""

_ELIGIBILITY = "eligibility"


@dataclass(frozen=True)
class PlasticSynapses:
    """The rules that synapses learn by, whose changes add up.

    Weights ``bounds.lo..bounds.hi`` is where learning may lead; a weight that begins outside may only come nearer. A
    ``source_index`` (targets, fan-in) names the sources that each target hears; without one it hears all.
    State: `change` (batch, ...) in the shape of the weights, and of each rule, by its number, its traces (batch,
    neurons), and `eligibility` (batch, ...) if it has one.
    """

    rules: Sequence[LearningRule]
    bounds: Interval
    source_index: Tensor | None

    def init_state(self, batch: int, weight: Tensor, sources: int) -> dict[str, Tensor]:
        """Return the state before learning."""
        state = {CHANGE: weight.new_zeros(batch, *weight.shape)}
        for number, rule in enumerate(self.rules):
            state |= {f"{number}.{name}": weight.new_zeros(batch, sources) for name in rule.source_traces}
            state |= {f"{number}.{name}": weight.new_zeros(batch, len(weight)) for name in rule.target_traces}
            if isinstance(rule, ModulatedRule) and rule.eligibility is not None:
                state[f"{number}.{_ELIGIBILITY}"] = torch.zeros_like(state[CHANGE])
        return state

    def currents(self, spikes: Tensor, change: Tensor) -> Tensor:
        """Return what a change (batch, ...) adds to the currents (steps, batch, targets) of spikes, (.., sources)."""
        if self.source_index is None:
            return torch.einsum("tbs,bns->tbn", spikes, change)
        return (spikes[..., self.source_index] * change).sum(-1)

    @torch.no_grad()
    def learn(
        self, weight: Tensor, activity: Activity, modulators: Sequence[Tensor | None], state: Mapping[str, Tensor]
    ) -> dict[str, Tensor]:
        """Return the state after a window, in which each rule's modulator, if any, was (batch, targets) or (batch, 1).

        Sums are in double precision, so that they round to the same numbers whatever the batch.
        """
        begun = weight + state[CHANGE]
        learned, after = begun.double(), dict(state)
        for number, (rule, modulator) in enumerate(zip(self.rules, modulators, strict=True)):
            names = [*rule.source_traces, *rule.target_traces]
            terms, traces = rule.terms(activity, {name: state[f"{number}.{name}"] for name in names})
            after |= {f"{number}.{name}": traces[name] for name in names}
            change = self._total([term for term in terms if modulator is None or not term.modulated])
            if modulator is not None:
                waiting, key = [term for term in terms if term.modulated], f"{number}.{_ELIGIBILITY}"
                if isinstance(rule, ModulatedRule) and rule.eligibility is not None:
                    heard, after[key] = self._remembered(waiting, state[key], activity.decay(rule.eligibility))
                else:
                    heard = self._total(waiting)
                change = change + modulator.double().view(*modulator.shape, *[1] * (weight.dim() - 1)) * heard
            learned += rule.learning_rate * change * (begun if rule.in_proportion else 1)
        lowest, highest = begun.clamp(max=self.bounds.lo), begun.clamp(min=self.bounds.hi)
        after[CHANGE] = learned.float().clamp(lowest, highest) - weight
        return after

    def _total(self, terms: Sequence[Term], counts: Tensor | None = None) -> Tensor:
        """Return the sum over terms and steps, which may count differently, of target times source."""
        total = torch.zeros((), dtype=torch.double)
        for term in terms:
            target, source = term.target.double(), term.source.double()
            if counts is not None:
                target = target * counts.view(-1, 1, 1)
            if self.source_index is None:
                total = total + torch.einsum("tbn,tbs->bns", target, source)
            else:
                total = total + torch.einsum("tbn,tbnk->bnk", target, source[..., self.source_index])
        return total

    def _remembered(self, terms: Sequence[Term], trace: Tensor, decay: float) -> tuple[Tensor, Tensor]:
        """Return the sum over steps of the eligibility trace, and the trace behind the last one."""
        steps = len(terms[0].target)
        left = decay ** torch.arange(steps - 1, -1, -1, dtype=torch.double)  # at the end, of what each step has added
        heard = (1 - decay * left) / (1 - decay)  # from each step to the end, all steps together
        total = decay * heard[0] * trace + self._total(terms, heard)
        return total, (decay * left[0] * trace + self._total(terms, left)).float()
