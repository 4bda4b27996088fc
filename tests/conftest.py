"""What all tests share: one thread, and reproducible examples."""

import os

from hypothesis import settings

# With two threads, torch stalls whenever another process is busy. Set before torch is imported, for children too.
os.environ["OMP_NUM_THREADS"] = "1"

settings.register_profile("neurorobo", derandomize=True, database=None, deadline=None)
settings.load_profile("neurorobo")
