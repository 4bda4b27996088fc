"""What a spiking network costs, in the terms of NeuroBench."""

from neurorobo.measures.size import Size, size_of
from neurorobo.measures.work import Work, WorkMeter

__all__ = ["Size", "Work", "WorkMeter", "size_of"]
