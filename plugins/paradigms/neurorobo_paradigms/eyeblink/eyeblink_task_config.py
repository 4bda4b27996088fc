"""The configuration of the eyeblink task; imports no torch."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from neurorobo.tasks.task import TaskConfig
from neurorobo.units import Duration, Unit


class EyeblinkTaskConfig(TaskConfig):
    """Shut the eye before the puff comes; an episode has all trials of the chamber."""

    implementation: ClassVar[str] = "neurorobo_paradigms.eyeblink.eyeblink_task:EyeblinkTask"

    type: Literal["paradigms.eyeblink"] = "paradigms.eyeblink"
    threshold: Annotated[float, Unit("1", gt=0, lt=1)] = Field(
        default=0.2, description="The closure from which on an eyelid has responded."
    )
    earliest: Duration = Field(
        default=50_000_000,
        description="A response counts as conditioned from this time after the onset of the tone on, until the puff.",
    )
    block: int = Field(default=10, ge=1, description="How many trials at the end of a phase its late figures are of.")
