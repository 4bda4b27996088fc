"""Precision physical interaction: the brain regions, teachers, baselines and simulated rig of Xing, Yang, Zhang and Xu."""

__version__ = "0.1.0"
