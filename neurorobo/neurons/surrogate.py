"""Surrogate derivatives of the firing step, used only on the way back."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, get_args

if TYPE_CHECKING:
    from torch import Tensor

SurrogateShape = Literal["rectangular", "triangular", "arctan", "fast_sigmoid"]


@dataclass(frozen=True)
class Surrogate:
    """What stands for the derivative of the firing step, as a function of the distance to the threshold.

    ``width`` is the full width at half maximum, in units of the membrane potential; every shape has area one, so
    shapes can be exchanged without retuning the learning rate. Sources: rectangular, Wu et al. 2018 (STBP); arctan,
    Fang et al. 2021; fast sigmoid, Zenke and Ganguli 2018; triangular, Bellec et al. 2018.
    """

    shape: SurrogateShape = "rectangular"
    width: float = 1.0

    def __post_init__(self) -> None:
        """Refuse an unknown shape and a width that is not positive and finite."""
        if self.shape not in get_args(SurrogateShape):
            raise ValueError(f"there is no surrogate {self.shape!r}; there are: {', '.join(get_args(SurrogateShape))}")
        if not 0 < self.width < math.inf:
            raise ValueError(f"a surrogate needs a positive width that is finite, got {self.width}")

    def fire(self, distance: "Tensor") -> "Tensor":
        """Return the spikes 0/1 of neurons at ``distance`` = potential - threshold (any shape, finite).

        On the way back, the step's derivative is the surrogate's.
        """
        slope = self.derivative(distance.detach()) * distance
        return (distance >= 0).to(distance.dtype) + (slope - slope.detach())

    def derivative(self, distance: "Tensor") -> "Tensor":
        """Return the surrogate derivative at ``distance`` = potential - threshold (any shape)."""
        import torch

        half = self.width / 2
        if self.shape == "rectangular":
            return (distance.abs() < half).to(distance.dtype) / self.width
        if self.shape == "triangular":
            return (1 - distance.abs() / self.width).clamp_(min=0) / self.width
        if self.shape == "arctan":
            least = distance.new_tensor(math.pi * half)
            return torch.addcmul(least, distance, distance, value=math.pi / half).reciprocal_()
        scale = (math.sqrt(2) - 1) / half
        return (distance.abs() * scale).add_(1).square_().reciprocal_().mul_(scale / 2)
