"""Codes on the native path say what they say in torch, bit for bit."""

import os
from collections.abc import Callable

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from neurorobo.codes import CoarseFine, Code, Poisson, PopulationNested, PopulationUniform, TimeToFirstSpike
from neurorobo.engine.coding import decode, encode
from tests.engine.paths import engine, instruction_sets, needs_native

pytestmark = needs_native()


@pytest.fixture(autouse=True, scope="module")
def native_path() -> object:
    with engine("native", os.environ.get("NEUROROBO_INSTRUCTIONS", "")):
        yield


def joined(neurons: int, lo: float, hi: float) -> Code:
    return CoarseFine.of(PopulationUniform(neurons, lo, hi), PopulationNested(3, lo, (lo + hi) / 2))


KINDS: tuple[Callable[[int, float, float], Code], ...] = (PopulationUniform, PopulationNested, joined, TimeToFirstSpike)


@given(
    kind=st.sampled_from(KINDS),
    neurons=st.integers(1, 600),
    steps=st.integers(2, 70),
    bounds=st.tuples(st.floats(-1e3, 1e3), st.floats(1e-3, 1e3)),
    batch=st.integers(1, 3),
    seed=st.integers(0, 1000),
)
def test_windows_are_those_of_the_code(
    kind: Callable[[int, float, float], Code],
    neurons: int,
    steps: int,
    bounds: tuple[float, float],
    batch: int,
    seed: int,
) -> None:
    lo, width = bounds
    code = kind(neurons, lo, lo + width)
    generator = torch.Generator().manual_seed(seed)
    values = lo + width * (1.4 * torch.rand(2, batch, generator=generator).t() - 0.2)  # some are out of range
    values[0, 0] = lo + width * round(float(values[0, 0])) / (2 * neurons * steps)  # between two counts, or near
    expected = code.encode(values, steps)
    for instructions in instruction_sets():
        with engine("native", instructions):
            found = encode(code, values, steps)
            assert torch.equal(found, expected)
            for spikes in (found, found.flip(0), found.transpose(0, 1).contiguous().transpose(0, 1)):
                assert torch.equal(decode(code, spikes), code.decode(spikes))


def test_halves_are_rounded_to_even_numbers_as_torch_does() -> None:
    code = PopulationUniform(1, 0.0, 64.0)
    values = (torch.arange(64) + 0.5).unsqueeze(1)
    assert torch.equal(encode(code, values, 64), code.encode(values, 64))
    assert encode(code, values, 64).sum(0).flatten().tolist()[:4] == [0, 2, 2, 4]


@pytest.mark.parametrize("value", [float("nan"), float("inf"), float("-inf")])
def test_what_is_not_finite_is_refused(value: float) -> None:
    with pytest.raises(ValueError, match=r"not finite cannot be encoded over 0\.\.1"):
        encode(PopulationUniform(10, 0.0, 1.0), torch.tensor([[0.5, value]]), 50)


def test_decoding_stays_differentiable() -> None:
    code = PopulationUniform(10, 0.0, 1.0)
    spikes = torch.zeros(50, 1, 10, requires_grad=True)
    decode(code, spikes).sum().backward()
    assert spikes.grad is not None
    assert torch.allclose(spikes.grad, torch.tensor(code.resolution(50)))


def test_poisson_spikes_are_counted() -> None:
    code = Poisson(10, -1.0, 1.0)
    spikes = code.encode(torch.rand(3, 2), 50, torch.Generator().manual_seed(0))
    assert torch.equal(decode(code, spikes), code.decode(spikes))


def test_spikes_of_a_wrong_number_of_neurons_are_refused() -> None:
    with pytest.raises(RuntimeError):
        decode(PopulationUniform(10, 0.0, 1.0), torch.zeros(50, 1, 15))
