"""Eligibility: what a modulator does to what a rule says, and that a late reward finds the synapse that earned it."""

import math

import torch

from neurorobo.plasticity.eligibility import Eligibility
from neurorobo.plasticity.rule import Activity, Term, all_to_all
from neurorobo.plasticity.stdp import PairStdp


def test_windows_make_no_difference_and_every_step_counts() -> None:
    """Compared with the equations, step by step."""
    generator = torch.Generator().manual_seed(1)
    target, source = (torch.rand(40, 2, n, generator=generator, dtype=torch.float64) for n in (3, 4))
    modulator = torch.randn(40, 2, 3, generator=generator, dtype=torch.float64)
    e, wanted = torch.zeros(2, 3, 4).double(), torch.zeros(2, 3, 4).double()
    for t in range(40):
        e = 0.9 * e + target[t, :, :, None] * source[t, :, None]
        wanted += modulator[t, :, :, None] * e
    for windows in (1, 5):
        trace, found = torch.zeros(2, 3, 4).double(), torch.zeros(2, 3, 4).double()
        pieces = zip(target.chunk(windows), source.chunk(windows), modulator.chunk(windows), strict=True)
        for a, b, m in pieces:
            changed, trace = Eligibility(0.9).learn([Term(a, b)], trace, m, all_to_all)
            found += changed
        torch.testing.assert_close(found, wanted)
        torch.testing.assert_close(trace, e)


def test_a_reward_that_comes_late_strengthens_the_synapse_that_earned_it() -> None:
    """The distal reward problem (Izhikevich 2007): only what one synapse did is rewarded, 0.2 to 1 s later.

    All fire at random at 5 Hz. When source 0 is by chance followed by the target within 10 ms, dopamine is due. In the
    meantime every other synapse was paired too; after some hundred rewards only the one stands out.
    """
    generator = torch.Generator().manual_seed(1)
    sources, window, windows = 20, 200, 2000  # of 1 ms each
    rule = PairStdp(a_plus=1.0, a_minus=1.5, tau_plus=20.0, tau_minus=20.0)
    eligibility = Eligibility(decay=math.exp(-1 / 500))
    state = rule.init_state(1, sources, 1)
    trace, weights = torch.zeros(1, 1, sources), torch.zeros(1, 1, sources)
    due: set[int] = set()
    rewards, last = 0, -window
    for number in range(windows):
        spikes = (torch.rand(window, 1, sources, generator=generator) < 0.005).float()
        target = (torch.rand(window, 1, 1, generator=generator) < 0.005).float()
        first = number * window
        events = [(t, False) for t in spikes[:, 0, 0].nonzero().flatten().tolist()]
        events += [(t, True) for t in target[:, 0, 0].nonzero().flatten().tolist()]
        for t, fired in sorted(events):
            if not fired:
                last = first + t
            elif 0 < first + t - last <= 10:
                due.add(first + t + int(torch.randint(200, 1000, (), generator=generator)))
        now = [at - first for at in due if at < first + window]
        due = {at for at in due if at >= first + window}
        dopamine = torch.zeros(window, 1, 1)
        dopamine[[at for at in now if at >= 0]] = 1.0
        rewards += len(now)
        terms, state = rule.terms(Activity(spikes, target), state)
        changed, trace = eligibility.learn(terms, trace, dopamine, all_to_all)
        weights = weights + changed
    others = weights[0, 0, 1:]
    assert rewards > 80
    assert weights[0, 0, 0] > others.max()
    assert weights[0, 0, 0] > others.mean() + 3 * others.std()
