"""The configurations of neurons: what a file says of them; they import no torch."""

from abc import ABC, abstractmethod
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from neurorobo.neurons.lif import LIF, just_above, spiking_neural_unit
from neurorobo.neurons.neuron import Neuron
from neurorobo.neurons.surrogate import Surrogate, SurrogateShape


class NeuronConfig(BaseModel, ABC):
    """Base of every neuron's configuration; like its module, it must not import torch outside of :meth:`build`."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    type: str

    @abstractmethod
    def build(self) -> Neuron:
        """Return the neuron."""


class SurrogateConfig(BaseModel):
    """What stands for the derivative of the firing step."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    shape: SurrogateShape = "rectangular"
    width: float = Field(default=1.0, gt=0, description="Full width at half maximum, in units of the potential.")

    def build(self) -> Surrogate:
        """Return the surrogate."""
        return Surrogate(self.shape, self.width)


class _Leaky(NeuronConfig):
    """What the neurons of the core have in common."""

    threshold: float = Field(default=0.5, gt=0)
    fires: Literal["at", "above"] = Field(
        default="at", description="Whether a potential that equals the threshold fires, or only one above it."
    )
    decay: float = Field(default=0.2, ge=0, le=1, description="What is left of the potential after one step.")
    surrogate: SurrogateConfig = SurrogateConfig()

    def _threshold(self) -> float:
        return just_above(self.threshold) if self.fires == "above" else self.threshold


class LIFConfig(_Leaky):
    """The iterative leaky integrate-and-fire neuron (Eq. 5-7 of Xing et al.)."""

    type: Literal["lif"] = "lif"
    reset_gradient: Literal["full", "detached"] = Field(
        default="full", description="Whether the gradient flows through the reset."
    )

    def build(self) -> LIF:
        """Return the neuron."""
        return LIF(self._threshold(), self.decay, self.surrogate.build(), self.reset_gradient)


class SpikingNeuralUnitConfig(_Leaky):
    """The spiking neural unit: an integrate-and-fire neuron whose potential is rectified (Wozniak et al. 2020)."""

    type: Literal["spiking_neural_unit"] = "spiking_neural_unit"

    def build(self) -> LIF:
        """Return the neuron."""
        return spiking_neural_unit(self._threshold(), self.decay, self.surrogate.build())
