"""The actor: what regions say to commands that are explored, with gradients."""

from collections.abc import Mapping

import torch
from torch import Tensor
from torch.distributions import Normal

from neurorobo.graph.plan import Plan, Use
from neurorobo.learning.experience import Experience
from neurorobo.learning.ppo_config import acting_use
from neurorobo.regions.region import Region
from neurorobo.regions.values import to_numbers


class Actor:
    """A Gaussian around what the regions say, for commands that are explored."""

    def __init__(self, regions: Mapping[str, Region], plan: Plan, deviations: Mapping[str, float]) -> None:
        """Prepare the commands in ``deviations``, in the actuators' units; each must come from one of the regions."""
        self.deviations = deviations
        self.regions = list(regions.values())
        self._uses: dict[str, tuple[Use, Region]] = {}
        self._columns: dict[str, list[tuple[str, slice]]] = {}  # of each step: outputs, and the components they command
        spread: list[float] = []
        for name, deviation in deviations.items():
            edge = plan.command[name]
            use = acting_use(edge, plan)
            assert use is not None
            self._uses[use.name] = use, regions[use.region]
            width = edge.reader_port.width
            self._columns.setdefault(use.name, []).append((edge.output, slice(len(spread), len(spread) + width)))
            spread += [deviation] * width
        self.spread = torch.tensor(spread)

    def means(self, experience: Experience, ticks: Tensor, episodes: Tensor) -> Tensor:
        """Return what the regions say now (n, components) at these ticks of these episodes, by number.

        Each step is run again on the very windows that it ran on then: what else the brain said before is as it was.
        """
        means = experience.mean[ticks, episodes].clone()
        for name, windows in experience.windows.items():
            use, region = self._uses[name]
            number = torch.full(experience.running.shape, -1)
            number[windows.tick, windows.episode] = torch.arange(len(windows.tick))
            chosen = number[ticks, episodes]
            ran = (chosen >= 0).nonzero().squeeze(1)
            if not len(ran):
                continue
            outputs, _ = region.step(*windows.choose(chosen[ran]))
            for output, columns in self._columns[name]:
                means[ran, columns] = to_numbers(outputs[output], use.outputs[output].code)
        return means


def log_probability(mean: Tensor, spread: Tensor, command: Tensor, due: Tensor) -> Tensor:
    """Return the logarithm of the probability density (n) of commands (n, components), of those that are due (0 or 1).

    ``spread`` (components) are the standard deviations of the Gaussian around ``mean`` (n, components).
    """
    log_density: Tensor = Normal(mean, spread).log_prob(command)
    return (log_density * due).sum(-1)
