"""Neuron models: pure steps and their surrogate derivatives."""

from neurorobo.neurons.config import NeuronConfig
from neurorobo.neurons.lif import LIF, just_above, spiking_neural_unit
from neurorobo.neurons.neuron import Neuron
from neurorobo.neurons.surrogate import Surrogate

__all__ = ["LIF", "Neuron", "NeuronConfig", "Surrogate", "just_above", "spiking_neural_unit"]
