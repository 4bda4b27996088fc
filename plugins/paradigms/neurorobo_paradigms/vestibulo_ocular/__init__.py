"""Adaptation of the vestibulo-ocular reflex: a turntable with a screen, and how well the eye holds the image."""
