"""The conformance kit: what every region and body, bundled or not, is tested with."""

from neurorobo.testing.body import check_body
from neurorobo.testing.conformance import ConformanceError, check_region

__all__ = ["ConformanceError", "check_body", "check_region"]
