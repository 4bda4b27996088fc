"""The critic: how much reward is still to be expected, from what the sensors say."""

from itertools import pairwise

import torch
from torch import Tensor, nn

from neurorobo.learning.ppo_config import CriticConfig


class Critic(nn.Module):
    """Observation (..., width) -> expected return (...), by a network of plain numbers.

    It computes in units of what :meth:`scale_to` was shown, so that its layers see and say numbers of the order of one.
    Fresh weights come from ``generator``.
    """

    observation_mean: Tensor
    observation_scale: Tensor
    return_mean: Tensor
    return_scale: Tensor

    def __init__(self, width: int, config: CriticConfig, generator: torch.Generator) -> None:
        super().__init__()
        sizes = [width, *config.hidden]
        layers: list[nn.Module] = []
        for before, after in pairwise(sizes):
            layers += [_linear(before, after, 2**0.5, generator), nn.Tanh()]
        self.layers = nn.Sequential(*layers, _linear(sizes[-1], 1, 1.0, generator))
        self.register_buffer("observation_mean", torch.zeros(width))
        self.register_buffer("observation_scale", torch.ones(width))
        self.register_buffer("return_mean", torch.zeros(()))
        self.register_buffer("return_scale", torch.ones(()))

    @torch.no_grad()
    def scale_to(self, observations: Tensor, returns: Tensor) -> None:
        """Take the units from observations (n, width) and returns (n)."""
        self.observation_mean.copy_(observations.mean(0))
        self.observation_scale.copy_(_spread(observations))
        self.return_mean.copy_(returns.mean(0))
        self.return_scale.copy_(_spread(returns))

    def scaled(self, returns: Tensor) -> Tensor:
        """Return returns in the critic's unit, in which its errors are of the order of one."""
        return (returns - self.return_mean) / self.return_scale

    def forward(self, observation: Tensor) -> Tensor:
        """Return the expected return (...) of observations (..., width)."""
        scaled = (observation - self.observation_mean) / self.observation_scale
        said: Tensor = self.layers(scaled)
        return self.return_mean + self.return_scale * said.squeeze(-1)


def _linear(sources: int, targets: int, gain: float, generator: torch.Generator) -> nn.Linear:
    layer = nn.Linear(sources, targets, device="meta").to_empty(device="cpu")  # drawing nothing by itself
    nn.init.orthogonal_(layer.weight, gain, generator=generator)
    nn.init.zeros_(layer.bias)
    return layer


def _spread(values: Tensor) -> Tensor:
    """Return the standard deviation along the first dimension, or one where nothing varies."""
    spread = values.std(0, correction=0)
    return torch.where(spread > 1e-6, spread, 1.0)
