"""The conformance kit: what every region, bundled or not, is tested with."""

from neurorobo.testing.conformance import ConformanceError, check_region

__all__ = ["ConformanceError", "check_region"]
