"""Plastic synapses: what modulators, bounds and the kind of synapses do to what a rule says."""

import math

import pytest
import torch

from neurorobo.neurons import LIF
from neurorobo.plasticity import Activity
from neurorobo.plasticity.stdp import PairStdp, TripletStdp
from neurorobo.plasticity.synapses import CHANGE, PlasticSynapses
from neurorobo.units import Interval
from tests.plasticity.learning import STEP_NS, change, train


def draw(generator: torch.Generator, *shape: int, rate: float = 0.2) -> torch.Tensor:
    return (torch.rand(shape, generator=generator) < rate).float()


@pytest.mark.parametrize("windows", [1, 5])
def test_eligibility_is_what_its_equations_say_step_by_step(windows: int) -> None:
    """Against a loop over time, with a modulator that differs from window to window and from target to target."""
    generator = torch.Generator().manual_seed(1)
    sources, targets = draw(generator, 40, 2, 4), draw(generator, 40, 2, 3)
    modulator = torch.randn(windows, 2, 3, generator=generator)
    rule = PairStdp(a_plus=0.5, a_minus=0.3, tau_plus="5 ms", tau_minus="8 ms", modulator="reward", eligibility="10 ms")
    x, y = torch.zeros(2, 4).double(), torch.zeros(2, 3).double()
    e, wanted = torch.zeros(2, 3, 4).double(), torch.zeros(2, 3, 4).double()
    for t in range(40):
        x = x * math.exp(-1 / 5) + sources[t]
        y = y * math.exp(-1 / 8)
        said = 0.5 * targets[t, :, :, None] * x[:, None] - 0.3 * y[:, :, None] * sources[t, :, None]
        y = y + targets[t]
        e = math.exp(-1 / 10) * e + said
        wanted += modulator[t * windows // 40, :, :, None] * e
    found = change(rule, sources, targets, windows=windows, modulator=modulator)
    torch.testing.assert_close(found, wanted.float(), rtol=1e-4, atol=1e-5)


def test_without_an_eligibility_trace_the_modulator_must_be_there() -> None:
    rule = PairStdp(modulator="reward")
    pair, told = (train([5], 40), train([8], 40)), torch.tensor([[[2.0]], [[0.0]]])
    assert float(change(rule, *pair, windows=2, modulator=told)) == pytest.approx(2 * float(change(PairStdp(), *pair)))
    assert float(change(rule, *pair, windows=2, modulator=told.flip(0))) == 0


def test_synapses_that_hear_some_sources_change_as_the_same_ones_of_a_full_matrix() -> None:
    generator = torch.Generator().manual_seed(3)
    index = torch.tensor([[0, 2], [3, 1], [4, 0]])
    sources, targets = draw(generator, 50, 2, 5), draw(generator, 50, 2, 3)
    reward = torch.randn(5, 2, 1, generator=generator)
    rule = TripletStdp(modulator="reward", eligibility="20 ms")
    full = change(rule, sources, targets, windows=5, modulator=reward)
    some = change(rule, sources, targets, windows=5, modulator=reward, source_index=index)
    torch.testing.assert_close(some, full.gather(2, index.expand(2, 3, 2)))


def test_a_weight_stays_within_its_bounds_and_comes_back_from_outside() -> None:
    synapses = PlasticSynapses([PairStdp(a_plus=0.3, a_minus=0.3)], Interval(0.0, 0.5), None)
    weight = torch.tensor([[0.4, 0.4, 0.9, -0.2]])
    state = synapses.init_state(1, weight, 4)
    first, second = torch.tensor([1.0, 0, 0, 0]), torch.tensor([0.0, 1, 1, 1])
    sources, targets = torch.zeros(10, 1, 4), torch.zeros(10, 1, 1)
    sources[2, 0], targets[4], sources[6, 0] = first, 1.0, second
    for _ in range(3):
        state = synapses.learn(weight, Activity(sources, targets, STEP_NS, LIF()), [None], state)
    up, down, back, outside = (weight + state[CHANGE]).flatten().tolist()
    assert up == 0.5
    assert down == 0.0
    assert 0 <= back < 0.5
    assert outside == pytest.approx(-0.2)


def test_a_reward_that_comes_late_strengthens_the_synapse_that_earned_it() -> None:
    """The distal reward problem (Izhikevich 2007): only what one synapse did is rewarded, 0.2 to 1 s later.

    All fire at random at 5 Hz. When source 0 is by chance followed by the target within 10 ms, dopamine is due. In the
    meantime every other synapse was paired too. Ten runs of 200 s, each with about 50 rewards.
    """
    runs, steps, window = 10, 200_000, 200
    generator = torch.Generator().manual_seed(1)
    rule = PairStdp(a_plus=1.0, a_minus=1.5, modulator="dopamine", eligibility="500 ms")
    spikes, target = (draw(generator, steps, runs, n, rate=0.005) for n in (20, 1))
    dopamine = torch.zeros(runs, steps)
    for run in range(runs):
        fired = spikes[:, run, 0].nonzero().flatten()
        for at in target[:, run].flatten().nonzero().flatten().tolist():
            if ((fired <= at) & (fired >= at - 10)).any():
                dopamine[run, min(steps - 1, at + int(torch.randint(200, 1000, (), generator=generator)))] += 1
    told = dopamine.view(runs, -1, window).sum(2).t().unsqueeze(2)
    rewarded, *others = change(rule, spikes, target, windows=len(told), modulator=told)[:, 0].unbind(1)
    noise = torch.stack(others)
    ahead = (rewarded - noise.mean(0)) / noise.std(0)
    assert ahead.mean() > 5 / runs**0.5  # five standard errors
