"""What a code costs in spikes, how finely it resolves, and what is left of a value when its spikes are disturbed.

Run ``python benchmarks/codes/robustness.py`` (seconds). Values of -1..1 are encoded, their spikes disturbed, and
decoded again; the table, in Markdown, gives the rms error in hundredths of the range, beside the resolution that the
code states. Poisson spikes are drawn, so that they err undisturbed as well.
"""

from collections.abc import Callable

import torch
from torch import Tensor

from neurorobo.codes import (
    Code,
    GaussianReceptiveFields,
    Poisson,
    PopulationNested,
    PopulationUniform,
    TimeToFirstSpike,
)
from neurorobo.codes.population_signed import PopulationSigned
from neurorobo.codes.rank_order import RankOrder

STEPS = 50
NEURONS = 10
VALUES = 4000
CODES: dict[str, type[Code]] = {
    "population_uniform": PopulationUniform,
    "population_nested": PopulationNested,
    "population_signed": PopulationSigned,
    "gaussian_receptive_fields": GaussianReceptiveFields,
    "poisson": Poisson,
    "time_to_first_spike": TimeToFirstSpike,
    "rank_order": RankOrder,
}


def as_they_are(spikes: Tensor, generator: torch.Generator) -> Tensor:
    """Disturb nothing."""
    return spikes


def lost(spikes: Tensor, generator: torch.Generator) -> Tensor:
    """Lose each spike with a probability of 5 %."""
    return spikes * (torch.rand(spikes.shape, generator=generator) >= 0.05)


def jittered(spikes: Tensor, generator: torch.Generator) -> Tensor:
    """Move each spike by up to two steps, evenly drawn; those that meet are one, none leaves the window."""
    moved = torch.zeros_like(spikes)
    step, batch, neuron = spikes.nonzero(as_tuple=True)
    by = torch.randint(-2, 3, step.shape, generator=generator)
    moved[(step + by).clamp(0, len(spikes) - 1), batch, neuron] = 1
    return moved


def delayed(spikes: Tensor, generator: torch.Generator) -> Tensor:
    """Delay all spikes by five steps; those that would come after the window are lost."""
    return torch.cat([torch.zeros_like(spikes[:5]), spikes[:-5]])


def without_one(spikes: Tensor, generator: torch.Generator) -> Tensor:
    """Silence one neuron of each value, whichever."""
    dead = torch.randint(NEURONS, spikes.shape[1:2], generator=generator)
    return spikes.masked_fill(torch.arange(NEURONS) == dead[:, None], 0)


DISTURBANCES: dict[str, Callable[[Tensor, torch.Generator], Tensor]] = {
    "undisturbed": as_they_are,
    "5 % lost": lost,
    "±2 steps": jittered,
    "5 steps late": delayed,
    "one neuron dead": without_one,
}


def main() -> None:
    """Print the table."""
    generator = torch.Generator().manual_seed(0)
    values = 2 * torch.rand(VALUES, 1, generator=generator, dtype=torch.float64) - 1
    print("| code | resolution | spikes |", " | ".join(DISTURBANCES), "|")
    print("| --- " * (3 + len(DISTURBANCES)) + "|")
    for name, kind in CODES.items():
        code = kind(NEURONS, -1.0, 1.0)
        spikes = code.encode(values, STEPS, generator)
        errors = [code.decode(disturb(spikes, generator)) - values for disturb in DISTURBANCES.values()]
        figures = [f"{50 * float(error.square().mean().sqrt()):.2g}" for error in errors]
        cost = float(spikes.sum() / VALUES)
        print(f"| `{name}` | {50 * code.resolution(STEPS):.2g} | {cost:.0f} |", " | ".join(figures), "|")


if __name__ == "__main__":
    main()
