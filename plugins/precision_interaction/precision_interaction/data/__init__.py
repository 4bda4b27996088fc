"""The data that the regions are trained on."""
