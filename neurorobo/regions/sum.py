"""The summing region."""

from collections.abc import Mapping

from torch import Tensor

from neurorobo.regions.region import Probe, Region, State


class Sum(Region):
    """``sum = a + b``, as numbers (batch, width); spiking neighbours are counted and re-emitted by their edges."""

    def step(
        self, inputs: Mapping[str, Tensor], state: State, probe: Probe | None = None
    ) -> tuple[dict[str, Tensor], State]:
        """Add the two inputs."""
        return {"sum": inputs["a"] + inputs["b"]}, state
