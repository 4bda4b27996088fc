"""An exponential that is the same number wherever it is computed."""

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from torch import Tensor

LEAST, MOST = -87.0, 88.0
"""Between these the result is a normal number of single precision."""

LN2_HIGH, LN2_LOW = 0.693359375, -2.12194440e-4
"""ln 2 in two parts, the first of few bits, so that whole multiples of it are exact."""

COEFFICIENTS = (1.9875691500e-4, 1.3981999507e-3, 8.3334519073e-3, 4.1665795894e-2, 1.6666665459e-1, 5.0000001201e-1)


def exponential(exponent: "Tensor") -> "Tensor":
    """Return ``exp(exponent)``, any shape, differentiable; an exponent beyond -87..88 counts as the nearest of them.

    In single precision each operation is rounded by itself and in one order, so that the native path computes the same
    bits; the relative error is below 2e-7. Other precisions take torch's own. Source of the polynomial: Moshier, Cephes
    2.2, ``expf``.
    """
    import torch

    x = exponent.detach().clamp(LEAST, MOST)
    if x.dtype is not torch.float32:
        power = x.exp()
    else:
        whole = (x * math.log2(math.e)).round()
        rest = x - whole * LN2_HIGH - whole * LN2_LOW
        sums = torch.full_like(rest, COEFFICIENTS[0])
        for coefficient in COEFFICIENTS[1:]:
            sums = sums * rest + coefficient
        sums = sums * rest * rest + rest + 1
        power = sums * ((whole.to(torch.int32) + 127) << 23).view(torch.float32)
    return power * (1 + (exponent - exponent.detach()))


def sigmoid(x: "Tensor") -> "Tensor":
    """Return ``1 / (1 + exp(-x))``, any shape, differentiable."""
    return 1 / (1 + exponential(-x))
