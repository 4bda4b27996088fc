"""The shipped weights, each with its model card; `benchmarks/training/ship.py` writes both."""
