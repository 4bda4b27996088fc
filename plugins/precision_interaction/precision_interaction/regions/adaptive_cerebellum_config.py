"""The configuration of a cerebellum that learns as it runs; imports no torch."""

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from neurorobo.clock import Clock
from neurorobo.regions import Port
from neurorobo.units import Unit
from precision_interaction.regions.cerebellum_config import CerebellumConfig


class AdaptiveCerebellumConfig(CerebellumConfig):
    """The cerebellum with plastic synapses from parallel fibres onto Purkinje cells, taught by climbing fibres.

    Weights are those of `precision.cerebellum`. A learning rate of 0 leaves it at that.
    """

    implementation: ClassVar[str] = "precision_interaction.regions.adaptive_cerebellum:AdaptiveCerebellum"
    accumulates: ClassVar[bool] = True

    type: Literal["precision.adaptive_cerebellum"] = "precision.adaptive_cerebellum"  # type: ignore[assignment]
    carry: Literal["always"] = "always"
    learning_rate: float = Field(
        default=0.0024,
        ge=0,
        description="What a plastic synapse changes by, as a share of its weight, for each mN of error and each spike.",
    )
    dead_zone: Annotated[float, Unit("mN", ge=0)] = Field(
        default=4.0, description="Errors count from here on; smaller ones are taken for noise."
    )
    habituation: int = Field(
        default=20, ge=1, description="Windows over which a granule cell's mean activity is taken."
    )
    tonic: float = Field(
        default=0.01, ge=0, description="Share of the mean activity that counts beside what differs from it."
    )
    forgetting: float = Field(
        default=0.005,
        ge=0,
        lt=1,
        description="Share of what was learned that fades with each window, as noise adds up.",
    )
    plastic_weight: float = Field(
        default=0.2,
        gt=0,
        description="Weight of a plastic synapse before learning, which as much inhibition from interneurons cancels; "
        "with learning it stays between 0 and twice that.",
    )

    def inputs(self, clock: Clock) -> dict[str, Port]:
        """Those of the cerebellum, and what the climbing fibres tell."""
        told = "Force that the move of the period before has left, told by climbing fibres; nothing is learned at 0."
        return {**super().inputs(clock), "error": Port("mN", 2, initial=(0.0, 0.0), description=told)}

    def signature(self, clock: Clock) -> Mapping[str, Any]:
        """Return that of the cerebellum, whose weights these are."""
        return {**super().signature(clock), "type": CerebellumConfig.model_fields["type"].default}
