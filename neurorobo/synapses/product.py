"""The matrix product behind dense projections, by the faster of torch's two libraries."""

from collections.abc import Callable
from functools import cache
from typing import Any

import torch
from torch import Tensor
from torch.autograd import forward_ad
from torch.nn import functional

LEAST_WORK = 2**20
"""Multiplications from which on the choice of a library pays for itself."""


def linear(rows: Tensor, weight: Tensor) -> Tensor:
    """Return ``rows @ weight.T`` (..., targets) of rows (..., sources) and weights (targets, sources), differentiable.

    torch multiplies numbers of 32 bits with MKL, which on AMD's processors takes twice the time of oneDNN, torch's
    other library. On Intel's they are about equal, so that oneDNN does all that is worth asking for.
    """
    if not _can_use_onednn(rows, weight):
        return functional.linear(rows, weight)
    if torch.is_grad_enabled() and (rows.requires_grad or weight.requires_grad):
        return _differentiable(rows, weight)
    product: Tensor = _onednn()(_matrix(rows), weight, None, "none", [], "")
    return product.resize_(*rows.shape[:-1], len(weight))  # a view could not be overwritten by an autograd function


def subtract_linear(sums: Tensor, rows: Tensor, weight: Tensor) -> None:
    """Subtract :func:`linear` from ``sums`` (rows, targets), in place and without gradients."""
    if _can_use_onednn(rows, weight):
        sums.sub_(linear(rows, weight))
    else:
        sums.addmm_(rows, weight.t(), alpha=-1)


class _Linear(torch.autograd.Function):
    """:func:`linear` with gradients, which can be differentiated in turn."""

    @staticmethod
    def forward(ctx: Any, rows: Tensor, weight: Tensor) -> Tensor:
        needs_rows, needs_weight = ctx.needs_input_grad
        ctx.save_for_backward(rows if needs_weight else None, weight if needs_rows else None)
        return linear(rows, weight)

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, Tensor | None]:
        rows, weight = ctx.saved_tensors
        for_rows = linear(grad, weight.t()) if ctx.needs_input_grad[0] else None
        if not ctx.needs_input_grad[1]:
            return for_rows, None
        return for_rows, linear(_matrix(grad).t(), _matrix(rows).t())


_differentiable: Callable[[Tensor, Tensor], Tensor] = _Linear.apply


def _matrix(rows: Tensor) -> Tensor:
    """Return rows (..., sources) as one matrix; of the ways to do so, the one that batches of gradients can go."""
    return rows.reshape(-1, rows.shape[-1])


def _can_use_onednn(rows: Tensor, weight: Tensor) -> bool:
    return (
        rows.numel() * len(weight) >= LEAST_WORK
        and rows.dtype is weight.dtype is torch.float32
        and rows.is_cpu
        and weight.is_cpu
        and rows.layout is weight.layout is torch.strided
        and rows.shape[-1] == weight.shape[-1]  # if not, torch says it with numbers
        and _onednn() is not None
        and not torch.compiler.is_compiling()
        and torch._C._get_tracing_state() is None
        and not torch._C._are_functorch_transforms_active()
        and not torch._C._functorch.is_legacy_batchedtensor(rows)
        and not torch._C._functorch.is_legacy_batchedtensor(weight)
        and forward_ad._current_level < 0
        and not torch._C._is_any_autocast_enabled()
    )


@cache
def _onednn() -> Any:
    """Return oneDNN's product, or None where torch was built without it."""
    if not torch.backends.mkldnn.is_available():
        return None
    return getattr(getattr(torch.ops.mkldnn, "_linear_pointwise", None), "default", None)
