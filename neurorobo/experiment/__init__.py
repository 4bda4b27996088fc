"""Experiments: building, running, training and recording what a file describes."""
