"""Path memory: an agent is led along paths, and finds them again alone."""
