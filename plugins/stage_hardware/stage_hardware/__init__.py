"""Drivers of stages and force sensors for neurorobo, and emulators of their controllers."""

__version__ = "0.1.0"
