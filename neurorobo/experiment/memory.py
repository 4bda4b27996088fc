"""What a brain has learned while it ran, from one episode to the next."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from neurorobo.graph.brain import Brain, BrainState
from neurorobo.regions.plastic import Plastic
from neurorobo.regions.region import State
from neurorobo.tasks.task import Flags


@dataclass
class Memory:
    """What the plastic regions of a brain know after the episodes so far; nothing before the first.

    ``learned`` has, of each such region, the named parts of its state; each episode of a batch goes on from its own.
    """

    learned: Mapping[str, State] = field(default_factory=dict)

    def recall(self, start: BrainState) -> BrainState:
        """Return the state at the start of episodes that know what was learned; a ValueError for more or fewer."""
        for state in self.learned.values():
            if any(len(value) != start.batch for value in state.values()):
                raise ValueError(f"the memory is of another number of episodes than {start.batch}")
        return _with(start, self.learned)

    def keep(self, brain: Brain, state: BrainState) -> None:
        """Remember what is known at the end of the episodes."""
        self.learned = dict(_learned(brain, state))


def only_running(brain: Brain, before: BrainState, after: BrainState, running: Flags) -> BrainState:
    """Return the state after a tick in which those episodes learned nothing that had already ended."""
    if running.all():
        return after
    goes_on = torch.from_numpy(running)
    old = dict(_learned(brain, before))

    def mixed(value: Tensor, held: Tensor) -> Tensor:
        return torch.where(goes_on.view(-1, *[1] * (value.dim() - 1)), value, held)

    kept = {
        name: {key: mixed(value, old[name][key]) for key, value in state.items()}
        for name, state in _learned(brain, after)
    }
    return _with(after, kept)


def _learned(brain: Brain, state: BrainState) -> Iterator[tuple[str, State]]:
    for name in brain.names:
        region = brain.region(name)
        if isinstance(region, Plastic):
            yield name, {key: state.regions[name][key] for key in region.learned}


def _with(state: BrainState, learned: Mapping[str, State]) -> BrainState:
    regions = {name: {**values, **learned.get(name, {})} for name, values in state.regions.items()}
    return replace(state, regions=regions)
