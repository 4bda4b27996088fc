"""Spiking brains for robots: regions declared in YAML, trained by their teachers, and run as one compiled graph."""

__version__ = "0.1.0"
