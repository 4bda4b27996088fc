"""The product behind projections: torch's own, by whichever library."""

import pytest
import torch
from torch import Tensor
from torch.nn import functional

from neurorobo.synapses import product
from neurorobo.synapses.product import linear, subtract_linear


def draw(*shape: int, seed: int = 0, requires_grad: bool = False) -> Tensor:
    """Whole numbers, whose products are exact in any order."""
    generator = torch.Generator().manual_seed(seed)
    return torch.randint(-8, 9, shape, generator=generator).float().requires_grad_(requires_grad)


SIZES = [((50, 3, 65), 130), ((128, 128), 128), ((2, 7), 3), ((0, 600), 2000), ((50, 1, 512), 512)]
large = pytest.mark.parametrize(("shape", "targets"), SIZES, ids=str)


@large
def test_it_is_torchs_product(shape: tuple[int, ...], targets: int) -> None:
    rows, weight = draw(*shape), draw(targets, shape[-1], seed=1)
    assert torch.equal(linear(rows, weight), functional.linear(rows, weight))
    transposed = draw(shape[-1], targets, seed=1).t()
    assert torch.equal(linear(rows, transposed), functional.linear(rows, transposed))


@pytest.mark.parametrize("rows", [1, 200])
def test_it_can_be_subtracted(rows: int) -> None:
    sums, spikes, weight = draw(rows, 130), draw(rows, 100, seed=1), draw(130, 100, seed=2)
    expected = sums - functional.linear(spikes, weight)
    subtract_linear(sums, spikes, weight)
    assert torch.equal(sums, expected)


@large
def test_gradients_are_those_of_torchs_product(shape: tuple[int, ...], targets: int) -> None:
    found = []
    for function in (linear, functional.linear):
        rows, weight = draw(*shape, requires_grad=True), draw(targets, shape[-1], seed=1, requires_grad=True)
        out = function(rows, weight)
        found.append(torch.autograd.grad(out, (rows, weight), draw(*out.shape, seed=2)))
    for ours, theirs in zip(*found, strict=True):
        assert torch.equal(ours, theirs)


def test_its_gradients_can_be_differentiated_again() -> None:
    found = []
    for function in (linear, functional.linear):
        rows, weight = draw(128, 128, requires_grad=True), draw(128, 128, seed=1, requires_grad=True)
        (first,) = torch.autograd.grad(function(rows, weight).square().sum(), rows, create_graph=True)
        found.append(torch.autograd.grad(first.sum(), weight)[0])
    assert torch.equal(*found)


def test_its_result_can_be_overwritten_by_an_autograd_function() -> None:
    rows, weight = draw(50, 3, 128), draw(128, 128, seed=1, requires_grad=True)
    assert not linear(rows, weight)._is_view()


def test_large_products_go_where_they_are_fast(monkeypatch: pytest.MonkeyPatch) -> None:
    if product._onednn() is None:
        pytest.skip("torch was built without oneDNN")
    called = []
    original = product._onednn()
    monkeypatch.setattr(product, "_onednn", lambda: lambda *given: called.append(given) or original(*given))
    linear(draw(512, 512), draw(512, 512))
    linear(draw(2, 512), draw(512, 512))
    assert len(called) == 1


def test_without_onednn_it_is_still_torchs_product(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(product, "_onednn", lambda: None)
    rows, weight = draw(512, 512), draw(512, 512, seed=1)
    assert torch.equal(linear(rows, weight), functional.linear(rows, weight))


@pytest.mark.parametrize("dtype", [torch.float64, torch.bfloat16])
def test_other_numbers_go_through_torch(dtype: torch.dtype) -> None:
    rows, weight = draw(512, 512).to(dtype), draw(512, 512, seed=1).to(dtype)
    assert torch.equal(linear(rows, weight), functional.linear(rows, weight))


def test_it_can_be_batched() -> None:
    rows, weight = draw(4, 256, 128), draw(128, 128, seed=1)
    batched = torch.func.vmap(linear, (0, None))(rows, weight)
    assert torch.equal(batched, functional.linear(rows, weight))
