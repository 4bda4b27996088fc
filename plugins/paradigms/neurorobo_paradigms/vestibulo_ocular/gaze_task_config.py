"""The configuration of the task of holding gaze; imports no torch."""

from typing import ClassVar, Literal

from pydantic import Field

from neurorobo.tasks.task import TaskConfig


class GazeTaskConfig(TaskConfig):
    """Keep the image still on the retina while the head turns, through all phases of the protocol."""

    implementation: ClassVar[str] = "neurorobo_paradigms.vestibulo_ocular.gaze_task:GazeTask"

    type: Literal["paradigms.stable_gaze"] = "paradigms.stable_gaze"
    scored_cycles: int = Field(
        default=5, ge=1, description="Figures of a phase are means over so many cycles at its end."
    )
