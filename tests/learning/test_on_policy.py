"""Learning from what a region meets by itself: how much, how fresh, and what an interruption leaves of it."""

from collections.abc import Mapping, Sequence
from typing import Any

import pytest
import torch
from torch import Tensor

from neurorobo.errors import NeuroroboError
from neurorobo.learning.on_policy import OnPolicyData
from neurorobo.learning.phase import OnPolicy
from neurorobo.regions.port import Port
from neurorobo.seeds import TRAINING_SEEDS

PORTS = {"x": Port("mN", 2), "before": Port("um", initial=(7.0,))}


class Zeros:
    """Data without `before`; all zeros, so that they can be told from what was met."""

    def __init__(self, *names: str) -> None:
        self.names = names or ("x",)

    def draw(self, batch: int, generator: torch.Generator) -> dict[str, Tensor]:
        return {name: torch.zeros(batch, 2) for name in self.names}


class Visits:
    """A closed loop in which each episode meets three inputs, all equal to the number of the visit, from one on."""

    def __init__(self, done: int = 0) -> None:
        self.seeds: list[Sequence[int]] = []
        self.done = done

    def fingerprint(self) -> str:
        return "the only one"

    def __call__(self, seeds: Sequence[int]) -> Mapping[str, Tensor]:
        with torch.inference_mode():
            self.seeds.append(seeds)
            number = float(len(self.seeds) + self.done)
            return {name: torch.full((3 * len(seeds), port.width), number) for name, port in PORTS.items()}


def data(visits: Visits, source: Zeros | None = None, **settings: Any) -> OnPolicyData:
    return OnPolicyData(source or Zeros(), visits, OnPolicy(**{"share": 0.5, **settings}), PORTS)


def draws(source: OnPolicyData, count: int, seed: int = 1) -> list[Mapping[str, Tensor]]:
    generator = torch.Generator().manual_seed(seed)
    return [source.draw(10, generator) for _ in range(count)]


@pytest.mark.parametrize(("share", "met"), [(0.5, 5), (0.12, 1), (0.07, 1), (1.0, 10)])
def test_a_share_of_each_batch_was_met_and_the_rest_drawn(share: float, met: int) -> None:
    [values] = draws(data(Visits(), share=share), 1)
    assert values["x"].tolist() == [[0.0, 0.0]] * (10 - met) + [[1.0, 1.0]] * met
    assert values["before"].tolist() == [[7.0]] * (10 - met) + [[1.0]] * met


def test_every_so_many_draws_it_acts_again_and_forgets_the_oldest() -> None:
    visits = Visits()
    drawn = draws(data(visits, every=2, keep=3, episodes=4), 12)
    assert len(visits.seeds) == 6
    seen = [set(values["before"][5:].flatten().tolist()) for values in drawn]
    for number, found in enumerate(seen):
        newest = number // 2 + 1
        assert found <= {newest, newest - 1, newest - 2} - {0, -1}
    assert set.union(*seen) == {1, 2, 3, 4, 5, 6}
    seeds = [seed for seeds in visits.seeds for seed in seeds]
    assert len(set(seeds)) == 24
    assert min(seeds) >= TRAINING_SEEDS[0] > 99


def test_what_was_met_can_be_trained_through() -> None:
    [values] = draws(data(Visits(), share=1.0), 1)
    weight = torch.ones(2, requires_grad=True)
    (values["x"] * weight).sum().backward()
    assert weight.grad is not None


def test_it_goes_on_after_an_interruption_as_if_there_had_been_none() -> None:
    whole = draws(data(Visits(), every=2), 7)
    before = data(Visits(), every=2)
    generator = torch.Generator().manual_seed(1)
    for _ in range(4):
        before.draw(10, generator)
    after = data(Visits(done=2), every=2)
    after.restore(before.tensors(), 4)
    for values in whole[4:]:
        again = after.draw(10, generator)
        assert all(torch.equal(values[name], again[name]) for name in values)


def test_data_that_the_region_cannot_meet_are_refused() -> None:
    with pytest.raises(NeuroroboError, match=r"have `befor`, which the region has no input for.*did you mean"):
        draws(data(Visits(), Zeros("x", "befor")), 1)


def test_data_must_have_what_has_no_initial_value() -> None:
    with pytest.raises(NeuroroboError, match="the training data have nothing for the input `x`"):
        draws(data(Visits(), Zeros("before")), 1)
