"""Regions: the units that plugins provide and graphs connect.

Only torch-free names are here; the network side is in :mod:`neurorobo.regions.region`.
"""

from neurorobo.regions.config import RegionConfig
from neurorobo.regions.port import Port

__all__ = ["Port", "RegionConfig"]
