"""The brain regions, teachers, baselines and simulated rig of a published controller for precise insertion."""

__version__ = "0.1.0"
