"""What the configurations of the analytic regions, teachers and baselines, have in common; imports no torch."""

from typing import Annotated

from pydantic import Field

from neurorobo.clock import Clock
from neurorobo.regions import RegionConfig
from neurorobo.units import Unit

Speed = Annotated[float, Unit("um/s", gt=0)]
StartSpeed = Annotated[float, Unit("um/s", ge=0)]
Acceleration = Annotated[float, Unit("um/s^2", gt=0)]


class AnalyticConfig(RegionConfig):
    """Base of the regions that compute with numbers and know the length of their period."""

    period: str = Field(description="Name of the period at which the region acts, as under `time`.")

    def period_s(self, clock: Clock) -> float:
        """Return the length of the period; a ConfigError if the clock has none of that name."""
        return clock.seconds(self.period)
