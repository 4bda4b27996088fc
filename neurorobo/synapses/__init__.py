"""Synapses: projections between populations, their signs and their connectivity."""

from neurorobo.synapses.projection import Dense, FanIn, Projection, Sign

__all__ = ["Dense", "FanIn", "Projection", "Sign"]
