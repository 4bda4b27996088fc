"""Ways to a controller."""
