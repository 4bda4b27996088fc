"""The configuration of a hippocampus that learns as it runs; imports no torch."""

from collections.abc import Mapping
from typing import Any, ClassVar, Literal

from pydantic import Field

from neurorobo.clock import Clock
from neurorobo.regions import Port
from precision_interaction.regions.hippocampus_config import HippocampusConfig


class AdaptiveHippocampusConfig(HippocampusConfig):
    """The hippocampus with plastic synapses onto its output neurons, taught by the contact that is felt.

    Weights are those of `precision.hippocampus`. Learning rates of 0 leave it at that. The use that expects the period
    to come is to commit its state, as the next one learns from it; a window without feedback begins a look ahead, from
    rest.
    """

    implementation: ClassVar[str] = "precision_interaction.regions.adaptive_hippocampus:AdaptiveHippocampus"
    accumulates: ClassVar[bool] = True
    not_in_signature: ClassVar[frozenset[str]] = HippocampusConfig.not_in_signature | {
        "learning_rate",
        "variance_learning_rate",
    }

    type: Literal["precision.adaptive_hippocampus"] = "precision.adaptive_hippocampus"  # type: ignore[assignment]
    carry: Literal["always"] = "always"
    outer: Literal[True] = True
    learning_rate: float = Field(
        default=0.3,
        ge=0,
        description="How much one lesson about the mean changes; at 1 about a third of its error is gone.",
    )
    variance_learning_rate: float = Field(
        default=0.06, ge=0, description="So for the variance, of which one period tells less."
    )

    def plain(self) -> HippocampusConfig:
        """Return the configuration of the hippocampus without what is learned."""
        names = set(HippocampusConfig.model_fields) - {"type", "carry"}
        return HippocampusConfig.model_validate(self.model_dump(mode="json", include=names))

    def inputs(self, clock: Clock) -> dict[str, Port]:
        """Those of the hippocampus, and how wrong it was about the period before."""
        nothing = (0.0, 0.0)
        return {
            **super().inputs(clock),
            "mean_error": Port("mN", 2, initial=nothing, description="Contact felt beyond the mean expected."),
            "variance_error": Port("mN^2", 2, initial=nothing, description="So for the variance."),
        }

    def signature(self, clock: Clock) -> Mapping[str, Any]:
        """Return that of the hippocampus, whose weights these are."""
        return {**super().signature(clock), "type": HippocampusConfig.model_fields["type"].default}
