"""Neuron models: pure steps and their surrogate derivatives."""

from neurorobo.neurons.lif import LIF, spiking_neural_unit
from neurorobo.neurons.surrogate import Surrogate

__all__ = ["LIF", "Surrogate", "spiking_neural_unit"]
