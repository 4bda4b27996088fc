"""Spiking brains for robots: brain regions declared in YAML, compiled to one graph, then trained, simulated and run."""

__version__ = "0.1.0"
