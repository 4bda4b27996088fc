"""The shipped weights, each with its model card; `tools/ship.py` beside this package writes both."""
