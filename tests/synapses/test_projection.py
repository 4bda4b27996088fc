"""Projections: connectivity, signs, and what is trained."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from neurorobo.synapses import Dense, FanIn, Projection, Sign


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


@given(sources=st.integers(1, 30), targets=st.integers(1, 30), data=st.data())
def test_fan_in_reads_exactly_that_many_different_sources(sources: int, targets: int, data: st.DataObject) -> None:
    fan_in = data.draw(st.integers(1, sources))
    projection = FanIn(sources, targets, fan_in, generator(data.draw(st.integers(0, 99))))
    for row in projection.source_index.tolist():
        assert len(set(row)) == len(row) == fan_in
        assert set(row) <= set(range(sources))


def test_fan_in_draws_its_sources_without_a_preference() -> None:
    """4000 granule cells with 4 of 64 mossy fibres each: 250 +- 15 on every fibre, within five standard deviations."""
    counts = FanIn(64, 4000, 4, generator()).source_index.flatten().bincount(minlength=64)
    assert (counts - 250).abs().max() < 5 * (4000 * (4 / 64) * (60 / 64)) ** 0.5


def test_fan_in_currents_are_those_of_a_gather_by_hand() -> None:
    projection = FanIn(10, 6, 3, generator())
    spikes = (torch.rand(7, 2, 10, generator=generator(1)) < 0.5).float()
    by_hand = torch.zeros(7, 2, 6)
    for target in range(6):
        for synapse, source in enumerate(projection.source_index[target].tolist()):
            by_hand[..., target] += projection.weight[target, synapse].item() * spikes[..., source]
    assert torch.allclose(projection(spikes), by_hand, atol=1e-6)
    assert torch.allclose(spikes @ projection.matrix().t(), by_hand, atol=1e-6)
    assert (projection.matrix() != 0).sum() == 6 * 3


@pytest.mark.parametrize("build", [lambda g: Dense(5, 4, g), lambda g: FanIn(5, 4, 2, g)], ids=["dense", "fan_in"])
def test_the_weights_are_trained_and_nothing_else(build) -> None:  # type: ignore[no-untyped-def]
    projection = build(generator())
    spikes = torch.ones(3, 2, 5)
    projection(spikes).sum().backward()
    assert [name for name, _ in projection.named_parameters()] == ["weight"]
    assert torch.allclose(projection.weight.grad, torch.full_like(projection.weight, 6.0))
    with torch.no_grad():
        projection.weight.add_(1.0)
    assert projection(spikes).sum() > 0  # the matrix follows its weights


@pytest.mark.parametrize("kind", ["dense", "fan_in"])
@pytest.mark.parametrize(("sign", "allowed"), [("excitatory", 1), ("inhibitory", -1)])
def test_signs_hold_from_the_start_and_are_restored(kind: str, sign: Sign, allowed: int) -> None:
    projection: Projection = (
        Dense(20, 10, generator(), sign=sign) if kind == "dense" else FanIn(20, 10, 5, generator(), sign=sign)
    )
    fresh = projection.weight.detach().clone()
    projection.constrain()
    assert torch.equal(projection.weight, fresh)
    assert (fresh * allowed >= 0).all()
    with torch.no_grad():
        projection.weight.add_(torch.randn(fresh.shape, generator=generator(1)))
    moved = projection.weight.detach().clone()
    projection.constrain()
    assert torch.equal(projection.weight, torch.where(moved * allowed > 0, moved, 0.0))
    assert (projection.matrix() * allowed >= 0).all()


def test_weights_without_a_sign_are_left_alone() -> None:
    projection = Dense(20, 10, generator())
    before = projection.weight.detach().clone()
    projection.constrain()
    assert torch.equal(projection.weight, before)
    assert (before > 0).any()
    assert (before < 0).any()


def test_fresh_weights_are_as_large_as_stated_and_come_from_the_generator() -> None:
    """A standard deviation of ``gain / sqrt(fan_in)``, within five standard errors of 40000 weights."""
    for projection, fan_in in (
        (Dense(100, 400, generator(), gain=3.0), 100),
        (FanIn(100, 10_000, 4, generator(), gain=3.0), 4),
    ):
        expected = 3.0 / fan_in**0.5
        assert abs(projection.weight.std().item() / expected - 1) < 5 / (2 * 40_000) ** 0.5
    one, same, other = (Dense(5, 5, generator(seed)).weight for seed in (1, 1, 2))
    assert torch.equal(one, same)
    assert not torch.equal(one, other)


@pytest.mark.parametrize("fan_in", [0, 6])
def test_an_impossible_fan_in_is_refused(fan_in: int) -> None:
    with pytest.raises(ValueError, match=f"a fan-in of {fan_in} cannot be drawn from 5 sources"):
        FanIn(5, 3, fan_in, generator())


@pytest.mark.parametrize(("sources", "targets"), [(0, 3), (3, 0), (-1, 3)])
def test_a_projection_of_nothing_is_refused(sources: int, targets: int) -> None:
    for build in (lambda: Dense(sources, targets, generator()), lambda: FanIn(sources, targets, 1, generator())):
        with pytest.raises(ValueError, match=f"at least one source and one target, got {sources} and {targets}"):
            build()


def test_more_synapses_than_can_be_counted_are_refused_before_they_are_drawn() -> None:
    for build in (lambda: Dense(2**16, 2**16, generator()), lambda: FanIn(2**16, 2**16, 2, generator())):
        with pytest.raises(ValueError, match="65536 sources onto 65536 targets would have 4294967296 synapses"):
            build()
    with pytest.raises(ValueError, match="2147483649 synapses, more than 2147483648"):
        Dense(2**31 + 1, 1, generator())
