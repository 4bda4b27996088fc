"""The configuration of a region: all that a graph can be checked with before any network is built."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, Literal

from pydantic import BaseModel, ConfigDict, Field

from neurorobo.clock import Clock
from neurorobo.regions.port import Port


class RegionConfig(BaseModel, ABC):
    """Base of every region's configuration; it must not import torch, so that files are checked and planned quickly.

    ``implementation`` names the class that is imported when the region is built, as ``"package.module:Class"``;
    ``pretrained_package`` the package that holds shipped weights, if there are any.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    implementation: ClassVar[str]
    pretrained_package: ClassVar[str | None] = None
    not_in_signature: ClassVar[frozenset[str]] = frozenset({"weights", "carry"})

    type: str
    weights: str | None = Field(
        default=None,
        description="`pretrained` for the shipped weights, or the path of a safetensors file; fresh ones if left out.",
    )
    carry: Literal["never", "repeat", "always"] = Field(
        default="never",
        description="How long the state lives: every use starts at rest, it survives within a repeat, or always.",
    )

    @abstractmethod
    def inputs(self, clock: Clock) -> dict[str, Port]:
        """Return the input ports by name."""

    @abstractmethod
    def outputs(self, clock: Clock) -> dict[str, Port]:
        """Return the output ports by name."""

    def signature(self, clock: Clock) -> Mapping[str, Any]:
        """Return what trained weights depend on; two regions of equal signature can exchange weights."""
        fields = self.model_dump(mode="json", exclude=set(self.not_in_signature))
        return {**fields, "window": clock.window}
