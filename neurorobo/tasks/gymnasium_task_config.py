"""The configuration of the task of a Gymnasium environment."""

from typing import ClassVar, Literal

from neurorobo.tasks.task import TaskConfig


class GymnasiumTaskConfig(TaskConfig):
    """The environment's own reward, and the end that it sets itself."""

    implementation: ClassVar[str] = "neurorobo.tasks.gymnasium_task:GymnasiumTask"

    type: Literal["gymnasium_reward"] = "gymnasium_reward"
