"""Climbing fibres: depression by them, potentiation without them, and the balance of both."""

import math

import pytest
import torch

from neurorobo.plasticity.climbing_fibre import ClimbingFibre
from tests.plasticity.learning import change, train

RULE = ClimbingFibre(modulator="climbing", ltp=0.01, ltd=0.05, tau="100 ms")


def test_only_parallel_fibres_that_fired_shortly_before_are_held_responsible() -> None:
    """The window of depression: a climbing fibre that tells 1 for a step, so long after or before a spike."""
    for delay in (-40, -1, 0, 1, 30, 90):
        told = torch.zeros(200, 1, 1)
        told[100 + delay] = 1
        found = float(change(RULE, train([100], 200), torch.zeros(200, 1, 1), windows=200, modulator=told))
        depression = 0.05 * math.exp(-delay / 100) if delay >= 0 else 0.0
        assert found == pytest.approx(0.01 - depression, rel=1e-4)


def test_both_balance_where_the_equations_say_whatever_the_parallel_fibres_do() -> None:
    balance = 0.01 / 0.05 * (1 - math.exp(-1 / 100))
    generator = torch.Generator().manual_seed(1)
    rates = torch.tensor([0.01, 0.05, 0.3])
    sources = (torch.rand(5000, 1, 3, generator=generator) < rates).float()
    sources[-1000:] = 0  # traces fade, so that all depression has come
    for told, sign in ((0.5, 1.0), (1.0, 0.0), (2.0, -1.0)):
        modulator = torch.full((1, 1, 1), told * balance)
        found = change(RULE, sources, torch.zeros(5000, 1, 1), modulator=modulator).flatten()
        by_potentiation = 0.01 * sources.sum((0, 1))
        torch.testing.assert_close(found / by_potentiation, torch.full((3,), 1 - told), atol=2e-3, rtol=0)
        assert sign == 0 or (found.sign() == sign).all()
