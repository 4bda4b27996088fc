"""The configurations of codes: what a file says of them; they import no torch."""

from abc import ABC, abstractmethod
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from neurorobo.codes.code import Code
from neurorobo.codes.first_spike import TimeToFirstSpike
from neurorobo.codes.rate import Poisson, PopulationNested, PopulationUniform
from neurorobo.codes.receptive_fields import LEAST_NEURONS, GaussianReceptiveFields


class CodeConfig(BaseModel, ABC):
    """Base of every code's configuration; like its module, it must not import torch."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    type: str

    @abstractmethod
    def build(self, lo: float, hi: float) -> Code:
        """Return the code of the values ``lo..hi``, in the unit of the port that carries it."""


class _PopulationConfig(CodeConfig):
    neurons: int = Field(default=10, ge=1, description="Neurons of each component of the quantity.")


class PopulationUniformConfig(_PopulationConfig):
    """As many spikes as the value asks for, spread evenly over neurons and steps."""

    type: Literal["population_uniform"] = "population_uniform"

    def build(self, lo: float, hi: float) -> PopulationUniform:
        """Return the code."""
        return PopulationUniform(self.neurons, lo, hi)


class PopulationNestedConfig(_PopulationConfig):
    """As many spikes as the value asks for; a larger value has those of a smaller one and more."""

    type: Literal["population_nested"] = "population_nested"

    def build(self, lo: float, hi: float) -> PopulationNested:
        """Return the code."""
        return PopulationNested(self.neurons, lo, hi)


class PoissonConfig(_PopulationConfig):
    """Independent spikes, the more probable the larger the value."""

    type: Literal["poisson"] = "poisson"

    def build(self, lo: float, hi: float) -> Poisson:
        """Return the code."""
        return Poisson(self.neurons, lo, hi)


class TimeToFirstSpikeConfig(_PopulationConfig):
    """One spike of each neuron, the earlier the larger the value; nothing can be trained through its decoding."""

    type: Literal["time_to_first_spike"] = "time_to_first_spike"

    def build(self, lo: float, hi: float) -> TimeToFirstSpike:
        """Return the code."""
        return TimeToFirstSpike(self.neurons, lo, hi)


class GaussianReceptiveFieldsConfig(CodeConfig):
    """Neurons that each answer to their own part of the range, the more the nearer the value is to their centre."""

    type: Literal["gaussian_receptive_fields"] = "gaussian_receptive_fields"
    neurons: int = Field(default=10, ge=LEAST_NEURONS, description="Neurons of each component of the quantity.")

    def build(self, lo: float, hi: float) -> GaussianReceptiveFields:
        """Return the code."""
        return GaussianReceptiveFields(self.neurons, lo, hi)
