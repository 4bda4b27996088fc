"""The engine: whole windows of spiking layers, in training and inference."""

from neurorobo.engine.layer import Layer
from neurorobo.engine.window import run_steps, run_window

__all__ = ["Layer", "run_steps", "run_window"]
