"""The configurations of neurons: what a file says of them; they import no torch."""

from abc import ABC, abstractmethod
from typing import Annotated, ClassVar, Literal

from pydantic import BaseModel, ConfigDict, Field

from neurorobo.neurons.lif import LIF, just_above, spiking_neural_unit
from neurorobo.neurons.neuron import Neuron
from neurorobo.neurons.soft_unit import SoftUnit
from neurorobo.neurons.surrogate import Surrogate, SurrogateShape
from neurorobo.units import Duration

TimeConstant = Annotated[Duration, Field(gt=0)]


class NeuronConfig(BaseModel, ABC):
    """Base of every neuron's configuration; like its module, it must not import torch outside of :meth:`build`.

    ``sends_spikes`` says that outputs are 0 or 1; a neuron that sends other numbers is for regions that can read them.
    ``trains_thresholds`` says that :meth:`build` returns LIF neurons, whose thresholds can be trained.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    sends_spikes: ClassVar[bool] = True
    trains_thresholds: ClassVar[bool] = False

    type: str

    def check(self, step_ns: int) -> None:
        """Raise a ValueError, with reason and cure, if the neuron cannot run at spike steps of ``step_ns``."""

    @abstractmethod
    def build(self, step_ns: int) -> Neuron:
        """Return the neuron that is advanced by steps of ``step_ns``, at which :meth:`check` raises nothing."""


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

    trains_thresholds: ClassVar[bool] = True

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

    def build(self, step_ns: int) -> LIF:
        """Return the neuron; it is the same at every step."""
        return LIF(self._threshold(), self.decay, self.surrogate.build(), self.reset_gradient)


class SpikingNeuralUnitConfig(_Leaky):
    """The spiking neural unit: an integrate-and-fire neuron whose potential is rectified (Wozniak et al. 2020)."""

    type: Literal["spiking_neural_unit"] = "spiking_neural_unit"

    def build(self, step_ns: int) -> LIF:
        """Return the neuron; it is the same at every step."""
        return spiking_neural_unit(self._threshold(), self.decay, self.surrogate.build())


class SoftSpikingNeuralUnitConfig(NeuronConfig):
    """The soft spiking neural unit, which sends a sigmoid of its potential in place of spikes (Wozniak et al. 2020)."""

    sends_spikes: ClassVar[bool] = False

    type: Literal["soft_spiking_neural_unit"] = "soft_spiking_neural_unit"
    threshold: float = Field(default=0.5, description="The potential at which it sends one half.")
    decay: float = Field(default=0.2, ge=0, le=1, description="What is left of the potential after one step.")
    slope: float = Field(default=1.0, gt=0, description="How steep the sigmoid is; four times its slope at one half.")

    def build(self, step_ns: int) -> SoftUnit:
        """Return the unit; it is the same at every step."""
        return SoftUnit(self.threshold, self.decay, self.slope)
