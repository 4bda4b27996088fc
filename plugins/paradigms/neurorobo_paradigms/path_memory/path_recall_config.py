"""The configuration of the task; imports no torch."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from neurorobo.tasks import TaskConfig
from neurorobo.units import Unit


class PathRecallConfig(TaskConfig):
    """Walk each path alone, from place to place in its order."""

    implementation: ClassVar[str] = "neurorobo_paradigms.path_memory.path_recall:PathRecall"

    type: Literal["paradigms.path_recall"] = "paradigms.path_recall"
    tolerance: Annotated[float, Unit("m", gt=0)] = Field(
        default=0.08, description="A waypoint is reached by coming as near."
    )
    lost: Annotated[float, Unit("m", gt=0)] = Field(
        default=0.15, description="An agent is lost once it is further from where the path goes on."
    )
