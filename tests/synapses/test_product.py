"""The product behind projections: torch's own, by whichever library."""

import pytest
import torch
from torch import Tensor
from torch.autograd import forward_ad
from torch.nn import functional

from neurorobo.learning.supervise import _products
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


@pytest.mark.parametrize("precision", ["ieee", "bf16"])
def test_the_wish_to_round_is_handed_on(capfd: pytest.CaptureFixture[str], precision: str) -> None:
    if product._onednn() is None:
        pytest.skip("torch was built without oneDNN")
    with _products(precision), torch.backends.mkldnn.verbose(torch.backends.mkldnn.VERBOSE_ON):
        linear(draw(512, 512), draw(512, 512))
    assert ("fpmath:bf16" in capfd.readouterr().out) == (precision == "bf16")


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


def test_a_single_row_is_a_product_too() -> None:
    row, weight = draw(1024, requires_grad=True), draw(1024, 1024, seed=1)
    out = linear(row, weight)
    assert torch.equal(out, functional.linear(row, weight))
    assert torch.equal(torch.autograd.grad(out.sum(), row)[0], weight.sum(0))


def test_its_gradients_come_in_batches() -> None:
    found = []
    for function in (linear, functional.linear):
        rows, weight = draw(128, 128, requires_grad=True), draw(128, 128, seed=1, requires_grad=True)
        out, grads = function(rows, weight), draw(3, 128, 128, seed=2)
        found.append(torch.autograd.grad(out, (rows, weight), grads, is_grads_batched=True))
    for ours, theirs in zip(*found, strict=True):
        assert torch.equal(ours, theirs)


@pytest.mark.filterwarnings("ignore:.torch.jit.script. is deprecated:DeprecationWarning")  # torch calls it itself
def test_forward_mode_goes_through_it() -> None:
    rows, weight = draw(128, 128), draw(128, 128, seed=1)
    with forward_ad.dual_level():
        out = linear(forward_ad.make_dual(rows, torch.ones_like(rows)), weight)
        assert torch.equal(forward_ad.unpack_dual(out).tangent, weight.sum(1).expand(128, 128))


@pytest.mark.filterwarnings("ignore:Sparse CSR tensor support is in beta state:UserWarning")
def test_sparse_weights_go_through_torch() -> None:
    rows, weight = draw(128, 128), draw(128, 128, seed=1)
    assert torch.equal(linear(rows, weight.to_sparse_csr()), functional.linear(rows, weight))


def test_sizes_that_do_not_fit_are_told_by_torch() -> None:
    with pytest.raises(RuntimeError, match="200x100 and 130x130"):
        linear(draw(200, 100), draw(130, 130))


def test_what_needs_no_gradient_may_change_before_the_way_back() -> None:
    rows, weight = draw(128, 128), draw(128, 128, seed=1, requires_grad=True)
    out = linear(rows, weight)
    with torch.no_grad():
        weight.zero_()
    assert torch.equal(torch.autograd.grad(out.sum(), weight)[0], rows.sum(0).expand(128, 128))
