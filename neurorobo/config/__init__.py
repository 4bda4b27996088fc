"""Configuration: YAML with places, units and overrides, checked against the models of the core and of plugins."""

from neurorobo.config.experiment import Experiment, load_experiment

__all__ = ["Experiment", "load_experiment"]
