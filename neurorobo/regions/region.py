"""The region: the unit that plugins provide and graphs connect."""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping

import torch
from torch import Tensor, nn

from neurorobo.clock import Clock
from neurorobo.engine import Layer, Probe
from neurorobo.regions.config import RegionConfig
from neurorobo.synapses import Projection

__all__ = ["Probe", "Region", "State", "constrain"]

State = dict[str, Tensor]
"""What a region remembers between uses: named tensors whose first dimension is the batch."""


class Region(nn.Module, ABC):
    """A brain region: typed ports, parameters, and an explicit state.

    Parameters live on the module, state never does: :meth:`step` assigns no attribute, so that one region can be used
    several times in a control period, on batches of any size, in any order.
    """

    def __init__(self, config: RegionConfig, clock: Clock, generator: torch.Generator) -> None:
        """Build the region; fresh weights are drawn from ``generator``."""
        super().__init__()
        self.config = config
        self.clock = clock
        self.input_ports = config.inputs(clock)
        self.output_ports = config.outputs(clock)

    def init_state(self, batch: int) -> State:
        """Return the state at rest of ``batch`` independent copies; nothing, unless a region says otherwise."""
        return {}

    @abstractmethod
    def step(
        self, inputs: Mapping[str, Tensor], state: State, probe: Probe | None = None
    ) -> tuple[dict[str, Tensor], State]:
        """Process one window: values of every input port -> values of every output port, and the new state.

        ``probe``, if given, is called with the spikes of each spiking layer.
        """

    def parameter_groups(self) -> Mapping[str, nn.Module]:
        """Return the parts of the region that learning phases can train or freeze by name."""
        return dict(self.named_children())

    def projections(self) -> Iterator[Projection]:
        """Yield every projection of the region, for the rules that act on synapses."""
        return (module for module in self.modules() if isinstance(module, Projection))


def constrain(region: Region) -> None:
    """Bring the synapses of a region back to their allowed signs, and trained thresholds to their allowed range."""
    for module in region.modules():
        if isinstance(module, Projection | Layer):
            module.constrain()
