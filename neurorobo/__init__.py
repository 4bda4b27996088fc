"""Spiking brains for robots: a graph of brain regions declared in YAML, compiled once, then trained, simulated and run."""

__version__ = "0.1.0"
