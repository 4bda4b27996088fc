"""What a region takes whether it runs or not: NeuroBench's static metrics."""

from dataclasses import astuple, dataclass
from operator import add

from neurorobo.measures.connections import connections, fan_out
from neurorobo.regions.region import Region


@dataclass(frozen=True)
class Size:
    """The static metrics of one or several regions, by NeuroBench's names and definitions (Yik et al. 2025).

    ``footprint`` is that of parameters and buffers in memory, in bytes. ``weights`` counts the places of all weight
    matrices, ``zeros`` those of them without a synapse: where there is none, and where its weight is zero.
    """

    parameter_count: int = 0
    footprint: int = 0
    weights: int = 0
    zeros: int = 0

    @property
    def connection_sparsity(self) -> float | None:
        """The share of zeros among the weights, not rounded; None if there are no weights."""
        return self.zeros / self.weights if self.weights else None

    def __add__(self, other: "Size") -> "Size":
        """Return the size of both."""
        return Size(*map(add, astuple(self), astuple(other)))


def size_of(region: Region) -> Size:
    """Return the size of a region."""
    weights = zeros = 0
    for module in connections(region):
        targets_of, targets = fan_out(module)
        weights += len(targets_of) * targets
        zeros += len(targets_of) * targets - int(targets_of.sum())
    tensors = [*region.parameters(), *region.buffers()]
    return Size(
        sum(parameter.numel() for parameter in region.parameters()),
        sum(tensor.numel() * tensor.element_size() for tensor in tensors),
        weights,
        zeros,
    )
