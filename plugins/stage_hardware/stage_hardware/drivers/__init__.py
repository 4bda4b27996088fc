"""Drivers of controllers and sensors."""
