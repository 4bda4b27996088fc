"""The engine: whole windows of spiking layers, in training and inference."""

from neurorobo.engine.circuit import Circuit
from neurorobo.engine.fired import BitProbe, Fired, Probe
from neurorobo.engine.layer import Layer
from neurorobo.engine.native import EnginePath, engine_path
from neurorobo.engine.window import run_neurons, run_steps, run_window

__all__ = [
    "BitProbe",
    "Circuit",
    "EnginePath",
    "Fired",
    "Layer",
    "Probe",
    "engine_path",
    "run_neurons",
    "run_steps",
    "run_window",
]
